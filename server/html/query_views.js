/* Views of results beside YASR's own: numbers over time as a plot, and what is linked to what as a picture. */
"use strict";
const queryViews = (() => {
  const XSD = "http://www.w3.org/2001/XMLSchema#";
  const NUMBERS = new Set(`integer decimal float double long int short byte nonNegativeInteger nonPositiveInteger
    negativeInteger positiveInteger unsignedLong unsignedInt unsignedShort unsignedByte`.split(/\s+/).map((name) => XSD + name));
  const TIMES = new Set([`${XSD}dateTime`, `${XSD}dateTimeStamp`]);
  const LINES = 16, HEIGHT = 360; // of a plot
  const VERTICES = 120, ROUNDS = 300; // of a picture of links, and of its layout
  const SVG = "http://www.w3.org/2000/svg";

  /* How a column can be drawn: "time", "number" or neither. */
  function kind(rows, name) {
    const cells = rows.map((row) => row[name]).filter(Boolean);
    const all = (types) => cells.length > 0 && cells.every(({ datatype }) => types.has(datatype));
    return all(TIMES) ? "time" : all(NUMBERS) ? "number" : "";
  }

  /* The columns of an answer; that of an ASK has none. */
  const variables = (results) => results.getVariables() ?? [];

  /* The labels of the lines, and the table that uPlot draws; null where there are no numbers over time. */
  function table(results, short) {
    const rows = results.getBindings() ?? [], columns = variables(results).map((name) => [name, kind(rows, name)]);
    const named = (wanted) => columns.filter(([, kind]) => kind === wanted).map(([name]) => name);
    const [time] = named("time"), numbers = named("number");
    if (!time || !numbers.length) return null;
    const rest = named(""), word = (cell) => cell ? cell.type === "uri" ? short(cell.value) : cell.value : "";
    const words = (row) => rest.map((name) => word(row[name])).join(" ");
    const isSplit = new Set(rows.map(words)).size * numbers.length <= LINES;
    const lines = new Map(); // by label: times and numbers
    for (const row of rows) {
      const at = Date.parse(row[time]?.value) / 1000;
      for (const name of Number.isFinite(at) ? numbers : []) {
        const number = Number(row[name]?.value);
        const label = [isSplit ? words(row) : "", numbers.length > 1 || !isSplit || !rest.length ? name : ""].filter(Boolean).join(" ") || name;
        if (!lines.has(label)) lines.set(label, new Map());
        if (Number.isFinite(number)) lines.get(label).set(at, number);
      }
    }
    const shown = [...lines].slice(0, LINES);
    const parts = shown.map(([, line]) => {
      const sorted = [...line].sort(([one], [other]) => one - other);
      return [sorted.map(([at]) => at), sorted.map(([, number]) => number)];
    });
    return { labels: shown.map(([label]) => label), data: uPlot.join(parts) };
  }

  const plotView = (short) => class Plot {
    priority = 5;
    label = "Plot";

    constructor(yasr) { this.yasr = yasr; }

    canHandleResults() { return Boolean(this.yasr.results && table(this.yasr.results, short)); }

    draw() {
      const { labels, data } = table(this.yasr.results, short);
      const root = document.createElement("div"), figure = document.createElement("figure");
      root.className = "plotting";
      root.append(figure);
      this.yasr.resultsEl.append(root);
      const size = () => ({ width: figure.clientWidth, height: HEIGHT });
      this.plot = new uPlot({ ...size(), series: chart.series(root, labels), axes: chart.axes(root), scales: chart.scales }, data, figure);
      figure.dataset.points = data[0].length;
      this.onResize = () => this.plot.setSize(size());
      addEventListener("resize", this.onResize);
    }

    destroy() {
      this.plot?.destroy();
      removeEventListener("resize", this.onResize);
    }
  };

  /* What is linked to what: triples of IRIs, of a graph, of three columns or of two. */
  function links(results) {
    const statements = results.getStatements?.();
    if (statements) {
      return statements.filter(({ object }) => object.termType === "NamedNode").map(({ subject, predicate, object }) => (
        { from: subject.value, by: predicate.value, to: object.value }
      ));
    }
    const names = variables(results), rows = results.getBindings() ?? [];
    const isLink = (row, name) => !row[name] || row[name].type === "uri";
    if (names.length < 2 || names.length > 3 || !rows.every((row) => names.every((name) => isLink(row, name)))) return [];
    const [from, to] = [names[0], names.at(-1)], by = names.length === 3 ? names[1] : null;
    return rows.filter((row) => row[from] && row[to]).map((row) => (
      { from: row[from].value, by: by ? row[by]?.value ?? "" : "", to: row[to].value }
    ));
  }

  /* Where each vertex stands, in a square of side 1: linked ones are drawn together, all others apart. */
  function layout(vertices, edges) {
    const places = vertices.map((_, at) => ({ x: 0.5 + 0.4 * Math.cos(at * 2.4) * Math.sqrt(at / vertices.length), y: 0.5 + 0.4 * Math.sin(at * 2.4) * Math.sqrt(at / vertices.length) }));
    const ideal = 0.8 / Math.sqrt(vertices.length || 1), index = new Map(vertices.map((each, at) => [each, at]));
    for (let round = 0; round < ROUNDS; round++) {
      const most = 0.05 * (1 - round / ROUNDS), moves = places.map(() => ({ x: 0, y: 0 }));
      const push = (one, other, force) => {
        const dx = places[one].x - places[other].x || 0.001, dy = places[one].y - places[other].y, length = Math.hypot(dx, dy);
        const share = force(length) / length;
        moves[one].x += dx * share; moves[one].y += dy * share;
        moves[other].x -= dx * share; moves[other].y -= dy * share;
      };
      for (let one = 0; one < places.length; one++) for (let other = 0; other < one; other++) push(one, other, (length) => ideal ** 2 / length);
      for (const { from, to } of edges) if (from !== to) push(index.get(from), index.get(to), (length) => -(length ** 2) / ideal);
      places.forEach((place, at) => {
        const { x, y } = moves[at], length = Math.hypot(x, y) || 1, step = Math.min(length, most) / length;
        place.x += x * step + (0.5 - place.x) * 0.01;
        place.y += y * step + (0.5 - place.y) * 0.01;
      });
    }
    const spread = (axis) => { const all = places.map((each) => each[axis]), least = Math.min(...all); return [least, Math.max(...all) - least || 1]; };
    const [left, width] = spread("x"), [top, height] = spread("y");
    return new Map(vertices.map((each, at) => [each, { x: (places[at].x - left) / width, y: (places[at].y - top) / height }]));
  }

  function drawn(name, attributes, ...children) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  const linksView = (short, href) => class Links {
    priority = 4;
    label = "Links";

    constructor(yasr) { this.yasr = yasr; }

    canHandleResults() { return Boolean(this.yasr.results && links(this.yasr.results).length); }

    draw() {
      const all = links(this.yasr.results), every = [...new Set(all.flatMap(({ from, to }) => [from, to]))];
      const vertices = every.slice(0, VERTICES), there = new Set(vertices);
      const edges = all.filter(({ from, to }) => there.has(from) && there.has(to));
      const width = Math.max(320, this.yasr.resultsEl.clientWidth), height = Math.max(320, Math.min(900, 90 * Math.sqrt(vertices.length) + 120));
      const places = layout(vertices, edges), at = (each) => ({ x: 95 + places.get(each).x * (width - 190), y: 24 + places.get(each).y * (height - 60) });
      const picture = drawn("svg", { class: "links", viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": "Links" });
      for (const { from, by, to } of edges) {
        const one = at(from), other = at(to);
        picture.append(drawn("line", { x1: one.x, y1: one.y, x2: other.x, y2: other.y }, drawn("title", {}, `${short(from)} ${short(by)} ${short(to)}`)));
        if (by && edges.length <= 40) picture.append(drawn("text", { class: "by", x: (one.x + other.x) / 2, y: (one.y + other.y) / 2 - 3 }, short(by)));
      }
      for (const each of vertices) {
        const { x, y } = at(each), name = short(each), mark = drawn("circle", { cx: x, cy: y, r: 5 });
        const text = drawn("text", { x, y: y + 18 }, name.length > 32 ? `…${name.slice(-31)}` : name);
        const target = href(each);
        picture.append(target ? drawn("a", { href: target }, drawn("title", {}, each), mark, text) : drawn("g", {}, mark, text));
      }
      this.yasr.resultsEl.append(picture);
      if (every.length > vertices.length) {
        const words = document.createElement("p");
        Object.assign(words, { className: "hint", textContent: `The first ${vertices.length} of ${every.length} are drawn.` });
        this.yasr.resultsEl.append(words);
      }
    }
  };

  return { plotView, linksView };
})();
