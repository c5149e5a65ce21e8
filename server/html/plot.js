/* Draws numbers over time: what is recorded of them first, then every message as it comes.

A page may have several plots; those that name the same stream share it. Without this file, or with scripts off, the page
tells which numbers there are. */
"use strict";
{
  const KEPT = 20000; // messages of a topic that are kept; of older ones every second
  const FRAME = 100, SECOND = 1000; // milliseconds between two drawings, and where nothing comes
  const POINTS = 1000; // of what is recorded of a number, at most
  const HEIGHT = 360;
  const SPAN = 60; // seconds that are seen where nobody can choose

  /* The streams that are open, by their addresses, each with what takes its events. */
  const streams = new Map();

  function open(address, taker) {
    const own = streams.get(address) ?? { takers: new Set(), source: null };
    streams.set(address, own);
    own.takers.add(taker);
    if (!own.source) connect(address, own);
    return () => {
      own.takers.delete(taker);
      if (own.takers.size) return;
      own.source?.close();
      streams.delete(address);
    };
  }

  function connect(address, own) {
    own.source?.close();
    own.source = new EventSource(address);
    for (const name of ["message", "open", "error"])
      own.source.addEventListener(name, (event) => own.takers.forEach((taker) => taker[name](event)));
  }

  addEventListener("pagehide", () => streams.forEach((own) => { own.source?.close(); }));
  addEventListener("pageshow", (event) => event.persisted && streams.forEach((own, address) => connect(address, own)));

  const titled = (label, unit) => unit ? `${label} (${unit})` : label;

  /* Draws one plot; what it returns ends that. */
  function draws(root) {
    const wanted = JSON.parse(root.dataset.plot);
    const element = (name) => root.querySelector(`[data-part=${name}]`);
    const figure = element("figure"), words = element("status"), pause = element("pause"), span = element("span");
    const isFilling = root.matches(".filling"); // its frame says how large it is
    const placed = new Map(wanted.y.map(({ place }, at) => [String(place ?? at), at])); // of the stream: ours

    /* A line is a number, or an element of an array: whose `column` of which table it is. */
    const lines = wanted.y.map(({ label, unit }, place) => ({ place, item: null, label: titled(label, unit) }));
    const tables = new Map(); // by topic: times (seconds) and, by place, values
    const past = new Map(), detail = new Map(); // by place: what is recorded, as [times, values]
    let view = null; // the times that are looked at; null: the newest
    let isHeld = false; // while a time is chosen, nothing moves
    let isPaused = false, ahead = 0, plot = null, isStale = true, lost = 0;

    /* What comes */

    function take(event) {
      for (const { times, values, lost: more, names = {} } of JSON.parse(event.data)) {
        const places = Object.keys(values).filter((each) => placed.has(each)), key = places.join();
        if (!places.length) continue;
        lost += more;
        if (!tables.has(key)) tables.set(key, { times: [], values: new Map(places.map((each) => [placed.get(each), []])) });
        const table = tables.get(key);
        for (const at of times) table.times.push(at / 1000);
        for (const place of places) {
          expand(placed.get(place), values[place], names[place]);
          table.values.get(placed.get(place)).push(...values[place]);
        }
        if (table.times.length > 2 * KEPT) thin(table);
        if (times.length) ahead = times.at(-1) - Date.now();
      }
      isStale = true;
      tell();
    }

    /* The first that comes of an array tells how many lines it takes, and what the robot calls each, where it says so. */
    function expand(place, values, names) {
      const first = values.find(Array.isArray), at = lines.findIndex((each) => each.place === place);
      const { item } = lines[at], { label, unit } = wanted.y[place];
      if (!first?.length || (item !== null && !names)) return;
      const old = lines.filter((each) => each.place === place), size = item === null ? first.length : old.length;
      const labels = Array.from({ length: size }, (_, each) => titled(names?.[each] ? `${label} ${names[each]}` : `${label}.${each}`, unit));
      if (item !== null && labels.every((each, row) => each === old[row].label)) return;
      lines.splice(at, old.length, ...labels.map((each, row) => ({ place, item: row, label: each })));
      build();
    }

    function thin(table) {
      const some = (column) => column.filter((_, row) => row >= KEPT || row % 2);
      table.times = some(table.times);
      for (const [place, column] of table.values) table.values.set(place, some(column));
    }

    /* What is recorded */

    async function recall(into, from, to) {
      await Promise.all(wanted.y.map(async ({ series }, place) => {
        if (!series) return;
        const query = `&from=${encodeURIComponent(from)}${to ? `&to=${encodeURIComponent(to)}` : ""}&points=${POINTS}`;
        try {
          const answer = await fetch(series + query, { headers: { accept: "application/json" } });
          if (answer.ok) into.set(place, points(await answer.json()));
        } catch {
          // not reachable: the status says so
        }
      }));
      isStale = true;
    }

    /* Of an interval both its minimum and its maximum are drawn. */
    function points({ time, value, min, max }) {
      const times = [], values = [];
      const add = (at, number) => { times.push(at); values.push(number); };
      time.forEach((text, row) => {
        const at = Date.parse(text) / 1000;
        if (value) return add(at, value[row]);
        const next = row + 1 < time.length ? Date.parse(time[row + 1]) / 1000 : at + 0.002;
        add(at, min[row]);
        add((at + next) / 2, max[row]);
      });
      return [times, values];
    }

    /* What is drawn */

    const now = () => (Date.now() + ahead) / 1000;
    const seconds = () => Number(span?.value ?? SPAN);
    const seen = () => view ?? { from: now() - seconds(), to: now() };

    /* The rows of ascending times that lie within, and one beyond on either side. */
    function within(times, from, to) {
      const first = (limit) => {
        let low = 0, high = times.length;
        while (low < high) {
          const middle = (low + high) >> 1;
          if (times[middle] < limit) low = middle + 1;
          else high = middle;
        }
        return low;
      };
      return [Math.max(first(from) - 1, 0), Math.min(first(to) + 1, times.length)];
    }

    function data({ from, to }) {
      const parts = [], columns = [];
      for (const { place, item } of lines) {
        const table = [...tables.values()].find((each) => each.values.has(place));
        const older = (view && detail.get(place)) ?? past.get(place) ?? [[], []];
        const until = view && detail.has(place) ? Infinity : table?.times[0] ?? Infinity;
        const times = [], values = [];
        let [at, end] = within(older[0], from, to);
        for (; at < end && older[0][at] < until; at++) { times.push(older[0][at]); values.push(older[1][at]); }
        if (table && until !== Infinity) {
          [at, end] = within(table.times, from, to);
          const column = table.values.get(place);
          for (; at < end; at++) {
            times.push(table.times[at]);
            values.push(item === null ? column[at] : column[at]?.[item] ?? null);
          }
        }
        parts.push([times, values]);
      }
      return parts.length ? uPlot.join(parts) : [[]];
    }

    function draw() {
      if (!plot || document.hidden || isHeld || !isStale) return;
      const shown = seen();
      isStale = false;
      plot.batch(() => {
        plot.setData(data(shown), false);
        plot.setScale("x", { min: shown.from, max: shown.to });
      });
      figure.dataset.points = plot.data[0].length;
    }

    const colour = (name) => chart.colour(root, name);

    const size = () => ({ width: figure.clientWidth, height: isFilling ? Math.max(figure.clientHeight - legend(), 80) : HEIGHT });
    const legend = () => figure.querySelector(".u-legend")?.offsetHeight ?? 24;

    function build() {
      plot ? plot.destroy() : figure.replaceChildren();
      plot = new uPlot({
        ...size(),
        series: chart.series(root, lines.map(({ label }) => label)),
        axes: chart.axes(root),
        scales: chart.scales,
        cursor: { drag: { x: true, y: false, setScale: false } },
        hooks: { setSelect: [zoom] },
      }, [[], ...lines.map(() => [])], figure);
      plot.over.addEventListener("mousedown", () => { isHeld = true; });
      plot.over.addEventListener("dblclick", follow);
      if (isFilling) plot.setSize(size()); // now its legend is there
      isStale = true;
      draw();
    }

    async function zoom(chart) {
      const { left, width } = chart.select;
      if (width < 4) return;
      view = { from: chart.posToVal(left, "x"), to: chart.posToVal(left + width, "x") };
      chart.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      detail.clear();
      isStale = true;
      tell();
      draw();
      const iso = (seconds) => new Date(seconds * 1000).toISOString();
      await recall(detail, iso(view.from), iso(view.to));
      draw();
    }

    function follow() {
      view = null;
      isPaused = false;
      detail.clear();
      isStale = true;
      tell();
      draw();
    }

    /* What is said and pressed */

    let isLost = false;

    function tell() {
      if (!words) return;
      const state = isLost ? "Not live" : view ? "Zoomed" : isPaused ? "Paused" : "Live";
      const left = lost ? `, ${lost} message${lost === 1 ? "" : "s"} not drawn` : "";
      if (words.textContent !== state + left) words.textContent = state + left;
      pause.textContent = view || isPaused ? "Go on" : "Pause";
    }

    pause?.addEventListener("click", () => {
      if (view || isPaused) return follow();
      const shown = seen();
      isPaused = true;
      view = shown;
      tell();
    });
    span?.addEventListener("change", () => recall(past, `-${span.value}`).then(draw));

    function save(blob, name) {
      const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    }

    const quoted = (text) => /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;

    element("csv")?.addEventListener("click", () => {
      const [times, ...columns] = data(seen());
      const rows = times.map((at, row) => [new Date(at * 1000).toISOString(), ...columns.map((each) => each[row] ?? "")]);
      const text = [["time", ...lines.map(({ label }) => quoted(label))], ...rows].map((row) => row.join(",")).join("\r\n");
      save(new Blob([text + "\r\n"], { type: "text/csv" }), "plot.csv");
    });

    element("png")?.addEventListener("click", () => {
      const drawn = plot.ctx.canvas, line = 22 * devicePixelRatio;
      const whole = Object.assign(document.createElement("canvas"), { width: drawn.width, height: drawn.height + line * lines.length });
      const context = whole.getContext("2d");
      context.fillStyle = colour("--card");
      context.fillRect(0, 0, whole.width, whole.height);
      context.drawImage(drawn, 0, 0);
      context.font = `${14 * devicePixelRatio}px sans-serif`;
      lines.forEach(({ label }, at) => {
        context.fillStyle = colour(`--line-${at % chart.COLOURS}`);
        context.fillText(`\u25a0 ${label}`, line / 2, drawn.height + line * (at + 0.7));
      });
      whole.toBlob((blob) => save(blob, "plot.png"), "image/png");
    });

    const close = open(wanted.stream, {
      message: take,
      open: () => { isLost = false; tell(); },
      error: () => { isLost = true; tell(); },
    });
    const ending = new AbortController(), { signal } = ending;

    addEventListener("mouseup", () => setTimeout(() => { isHeld = false; }), { signal });
    const fit = () => {
      plot?.setSize(size());
      isStale = true;
    };
    const observer = new ResizeObserver(fit);
    if (isFilling) observer.observe(figure);
    addEventListener("resize", fit, { signal });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build, { signal });
    document.addEventListener("visibilitychange", () => { isStale = true; }, { signal });

    for (const each of root.querySelectorAll("[hidden]")) each.hidden = false;
    build();
    recall(past, `-${seconds()}`).then(draw);
    const timers = [
      setInterval(draw, FRAME),
      setInterval(() => { isStale ||= !view; }, SECOND), // time goes on where nothing comes
    ];

    return () => {
      close();
      ending.abort();
      observer.disconnect();
      timers.forEach(clearInterval);
      plot.destroy();
    };
  }

  /* The plots of the page: those that came with it or since, and not those that are gone or have become others. */
  const drawn = new Map();

  function look() {
    for (const [root, { told, end }] of drawn)
      if (!root.isConnected || root.dataset.plot !== told) {
        drawn.delete(root);
        end();
      }
    for (const root of document.querySelectorAll("[data-plot]"))
      if (!drawn.has(root)) drawn.set(root, { told: root.dataset.plot, end: draws(root) });
  }

  document.addEventListener("shown", look);
  look();
}
