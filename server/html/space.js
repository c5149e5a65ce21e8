/* Draws what a robot tells of space from above: scans, maps, paths, poses, frames.

It takes every element that has data-space, the address of a view, whose event stream tells what is drawn and where that
is in the frame that the view is fixed to. Without this file, and space_view.js, the page tells the same in words. */
"use strict";
{
  const TRACE = 5000, STEP = 0.02; // points of a trace, and metres between two of them
  const PAST = 600; // seconds of a trace that are asked of what is recorded
  const LEAST = 0.5, MOST = 20000; // pixels of a metre
  const LOOK = 1000; // milliseconds between two looks whether all is in the window still

  const { element, button } = SpaceView;
  const colour = (at, name) => getComputedStyle(at).getPropertyValue(name).trim();
  const isDark = matchMedia("(prefers-color-scheme: dark)");

  /* Asks whether a goal is to be sent: shows what and where to, and sends it. Escape cancels. */
  class GoalDialog {
    constructor(view) {
      this.view = view;
      const number = (step) => element("input", { type: "number", step, required: true });
      this.target = element("select");
      [this.x, this.y, this.heading] = [number("any"), number("any"), number("any")];
      this.text = element("code");
      this.error = element("p", { className: "error" });
      this.error.setAttribute("role", "alert");
      this.send = element("button", { type: "submit", textContent: "Send" });
      const title = element("h2", { textContent: "Send a goal?", id: "goal-title" });
      const field = (words, input) => element("label", {}, words, input);
      const form = element("form", {}, title, field("To ", this.target),
        element("div", { className: "goal" }, field("x, m ", this.x), field("y, m ", this.y), field("heading, ° ", this.heading)),
        element("pre", {}, this.text), this.error,
        element("p", { className: "do" }, this.send, " ", button("Cancel", "Cancel", () => this.dialog.close())));
      this.dialog = element("dialog", { className: "form" }, form);
      this.dialog.setAttribute("aria-labelledby", "goal-title");
      form.addEventListener("input", () => this.show());
      form.addEventListener("submit", (event) => {
        event.preventDefault();
        this.post();
      });
      this.dialog.addEventListener("close", () => {
        this.dialog.remove();
        view.aim = null;
        view.renew();
      });
    }

    open({ x, y, heading }) {
      const { goals, canvas } = this.view, chosen = this.target.value;
      this.target.replaceChildren(...goals.map(({ name, url, type }) => element("option", { value: url, textContent: `${name} (${type})` })));
      if (goals.some(({ url }) => url === chosen)) this.target.value = chosen;
      [this.x.value, this.y.value, this.heading.value] = [x.toFixed(3), y.toFixed(3), ((heading * 180) / Math.PI).toFixed(1)];
      this.error.textContent = "";
      this.send.disabled = false;
      document.body.append(this.dialog);
      this.show();
      this.dialog.showModal();
      this.send.focus();
      canvas.dataset.asked = Number(canvas.dataset.asked ?? 0) + 1;
    }

    get goal() {
      return this.view.goals.find(({ url }) => url === this.target.value);
    }

    /* The message: the pose in the frame that the view is fixed to, with the time of the server. */
    message() {
      const { frame, clock } = this.view, { field, stamped } = this.goal, half = (Number(this.heading.value) * Math.PI) / 360;
      const now = clock.now === null ? 0 : clock.now + (performance.now() - clock.read) / 1000, sec = Math.floor(now);
      const position = { x: Number(this.x.value), y: Number(this.y.value), z: 0 };
      const pose = { position, orientation: { x: 0, y: 0, z: Math.sin(half), w: Math.cos(half) } };
      const stamp = { sec, nanosec: Math.floor((now - sec) * 1e9) };
      const value = stamped ? { header: { stamp, frame_id: frame }, pose } : pose;
      return field ? { [field]: value } : value;
    }

    show() {
      const { goal } = this;
      if (!goal) return this.refuse("No goals are accepted now.");
      this.text.textContent = `${goal.method} ${goal.url}\n${JSON.stringify(this.message(), null, 2)}`;
      const half = (Number(this.heading.value) * Math.PI) / 360;
      this.view.aim = { x: Number(this.x.value), y: Number(this.y.value), heading: 2 * half };
      this.view.renew();
    }

    refuse(words) {
      this.error.textContent = words;
      this.send.disabled = false;
    }

    async post() {
      const { goal } = this;
      if (!goal) return this.refuse("No goals are accepted now.");
      this.send.disabled = true;
      const headers = { accept: "application/json", "content-type": "application/json", prefer: "return=minimal" };
      try {
        const answer = await fetch(goal.url, { method: goal.method, headers, body: JSON.stringify(this.message()) });
        if (!answer.ok) return this.refuse((await answer.json()).detail);
        const place = answer.headers.get("location"), said = answer.status === 202 ? "Sent, but without a receiver: " : "Sent to ";
        const link = place ? element("a", { href: new URL(place, location.href).pathname, textContent: goal.name }) : goal.name;
        this.view.readout.replaceChildren(said, link);
        this.dialog.close();
      } catch {
        this.refuse("No answer: it is unknown whether the goal arrived.");
      }
    }
  }

  /* A pose (x, y, z and a quaternion) as the two upper rows of its matrix: all that is seen from above. */
  function rows([x, y, z, a, b, c, w]) {
    return [
      1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w), x,
      2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w), y,
    ];
  }
  const across = (m, x, y, z) => m[0] * x + m[1] * y + m[2] * z + m[3];
  const up = (m, x, y, z) => m[4] * x + m[5] * y + m[6] * z + m[7];
  const at = (m, x, y, z = 0) => [across(m, x, y, z), up(m, x, y, z)];

  function projected(m, { x, y, z }) {
    const found = new Float64Array(2 * x.length);
    for (let row = 0; row < x.length; row++) {
      const height = z ? z[row] : 0;
      found[2 * row] = across(m, x[row], y[row], height);
      found[2 * row + 1] = up(m, x[row], y[row], height);
    }
    return found;
  }

  class View extends SpaceView {
    constructor(figure, address) {
      super(figure, address);
      this.frame = "";
      this.hasFrames = true;
      this.centre = [0, 0];
      this.scale = 50; // pixels of a metre
      this.pointers = new Map();
      this.goals = []; // what a pose can be sent to
      this.clock = { now: null, read: 0 }; // the server's time when they were told, and the page's
      this.aim = null; // the pose that is being chosen
      this.isAiming = false;
      this.dialog = new GoalDialog(this);
      this.build();
    }

    build() {
      this.words = element("span", { textContent: "Not live yet" });
      this.words.setAttribute("role", "status");
      const frames = element("input", { type: "checkbox", checked: true });
      frames.addEventListener("change", () => { this.hasFrames = frames.checked; this.renew(); });
      this.tool = button("Send a goal", "Send a goal: click on the map, and drag for the heading", ({ detail }) => {
        if (detail) this.startAiming(!this.isAiming);
        else this.dialog.open({ x: this.centre[0], y: this.centre[1], heading: 0 }); // by the keyboard
      });
      this.tool.hidden = true;
      this.controls = element("div", { className: "controls" }, this.words,
        button("Fit", "Fit", () => { this.isMoved = false; this.followNothing(); this.fit(); }),
        button("\u2212", "Zoom out", () => this.zoom(0.7)), button("+", "Zoom in", () => this.zoom(1 / 0.7)),
        this.chooseFollowed(), element("label", { className: "tick" }, frames, " Frames"), this.tool);
      this.canvas = element("canvas", { tabIndex: 0 });
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", "Seen from above. Arrow keys move it, plus and minus zoom, 0 fits all in.");
      this.readout = element("p", { className: "readout" });
      this.legend = element("ul", { className: "legend" });
      this.figure.prepend(this.controls, this.canvas, this.readout, this.legend);
      this.listen();
    }

    listen() {
      const { canvas } = this;
      canvas.addEventListener("keydown", (event) => {
        const far = 60 / this.scale;
        const moves = { ArrowLeft: [-far, 0], ArrowRight: [far, 0], ArrowUp: [0, far], ArrowDown: [0, -far] };
        if (event.key === "Escape" && this.isAiming) this.startAiming(false);
        else if (moves[event.key]) this.move(...moves[event.key]);
        else if (event.key === "+" || event.key === "=") this.zoom(1.25);
        else if (event.key === "-") this.zoom(0.8);
        else if (event.key === "0") { this.isMoved = false; this.fit(); }
        else return;
        event.preventDefault();
      });
      canvas.addEventListener("wheel", (event) => {
        if (document.activeElement !== canvas && !event.ctrlKey) return; // the page scrolls
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY / 400), this.place(event));
      }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        canvas.setPointerCapture(event.pointerId);
        if (this.isAiming && event.button === 0) {
          const [x, y] = this.place(event);
          this.aim = { x, y, heading: 0, pointer: event.pointerId };
          return this.renew();
        }
        this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
      });
      const end = (event) => {
        this.pointers.delete(event.pointerId);
        if (this.aim?.pointer !== event.pointerId) return;
        const aim = this.aim;
        this.startAiming(false);
        if (event.type === "pointerup") this.dialog.open(aim);
      };
      canvas.addEventListener("pointerup", end);
      canvas.addEventListener("pointercancel", end);
      canvas.addEventListener("pointermove", (event) => this.point(event));
      new ResizeObserver(() => this.resize()).observe(canvas);
      isDark.addEventListener("change", () => {
        for (const thing of this.things) thing.shade = null;
        this.renew();
      });
    }

    /* One finger, or the mouse, moves; two zoom. */
    point(event) {
      const place = this.place(event);
      this.readout.textContent = `${place[0].toFixed(2)}, ${place[1].toFixed(2)} m${this.frame ? ` in ${this.frame}` : ""}`;
      if (this.aim?.pointer === event.pointerId) {
        const [along, across] = [place[0] - this.aim.x, place[1] - this.aim.y];
        if (Math.hypot(along, across) * this.scale > 8) this.aim.heading = Math.atan2(across, along);
        return this.renew();
      }
      const before = this.pointers.get(event.pointerId);
      if (!before) return;
      const now = [event.clientX, event.clientY];
      const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
      this.pointers.set(event.pointerId, now);
      if (!other) return this.move((before[0] - now[0]) / this.scale, (now[1] - before[1]) / this.scale);
      const apart = (each) => Math.hypot(each[0] - other[0], each[1] - other[1]) || 1;
      this.zoom(apart(now) / apart(before), this.place({ clientX: (now[0] + other[0]) / 2, clientY: (now[1] + other[1]) / 2 }));
    }

    /* Whether the next click on the map chooses a goal. */
    startAiming(isAiming) {
      this.isAiming = isAiming;
      this.aim = null;
      this.tool.setAttribute("aria-pressed", isAiming);
      this.canvas.classList.toggle("aiming", isAiming);
      if (isAiming) {
        this.isMoved = true; // it stays as it is under the pointer
        this.readout.textContent = "Click the goal, drag for its heading. Escape cancels.";
        this.canvas.focus({ preventScroll: true });
      }
      this.renew();
    }

    place({ clientX, clientY }) {
      const box = this.canvas.getBoundingClientRect();
      return [
        this.centre[0] + (clientX - box.left - box.width / 2) / this.scale,
        this.centre[1] - (clientY - box.top - box.height / 2) / this.scale,
      ];
    }

    move(x, y) {
      this.isMoved = true;
      this.followed = this.choice.value = "";
      this.centre = [this.centre[0] + x, this.centre[1] + y];
      this.renew();
    }

    zoom(factor, about = this.centre) {
      const scale = Math.min(Math.max(this.scale * factor, LEAST), MOST), share = 1 - this.scale / scale;
      this.isMoved = true;
      this.centre = this.centre.map((each, axis) => each + (about[axis] - each) * share);
      this.scale = scale;
      this.renew();
    }

    /* The sides of all that is drawn: left, right, bottom, top; null where nothing is. */
    bounds() {
      const xs = [], ys = [], add = (x, y) => { xs.push(x); ys.push(y); };
      for (const thing of this.things) {
        if (!thing.matrix || thing.isHidden) continue;
        for (const points of [thing.points, thing.line]) {
          for (let each = 0; points && each < points.length; each += 2) add(points[each], points[each + 1]);
        }
        for (const arrow of thing.drawing?.arrows ?? []) add(...at(thing.matrix, ...arrow));
        for (const corner of thing.corners ?? []) add(...corner);
      }
      for (const { pose } of this.frames.values()) add(pose[0], pose[1]);
      const least = (all) => all.reduce((one, other) => Math.min(one, other), Infinity);
      const most = (all) => all.reduce((one, other) => Math.max(one, other), -Infinity);
      return xs.length ? [least(xs), most(xs), least(ys), most(ys)] : null;
    }

    /* All in the window that is drawn. */
    fit() {
      const bounds = this.bounds();
      if (bounds) {
        const [left, right, bottom, top] = bounds;
        const { clientWidth, clientHeight } = this.canvas;
        const wanted = 0.92 * Math.min(clientWidth / Math.max(right - left, 2), clientHeight / Math.max(top - bottom, 2));
        this.centre = [(left + right) / 2, (bottom + top) / 2];
        this.scale = Math.min(Math.max(wanted, LEAST), MOST);
      }
      this.renew();
    }

    /* Whether something is drawn beyond the window. */
    isOutgrown() {
      const bounds = this.bounds();
      if (!bounds) return false;
      const [wide, high] = [this.canvas.clientWidth / 2 / this.scale, this.canvas.clientHeight / 2 / this.scale];
      const [left, right, bottom, top] = bounds, [x, y] = this.centre;
      return left < x - wide || right > x + wide || bottom < y - high || top > y + high;
    }

    /* What comes */

    take({ show, frame, frames, things, goals, now: time }) {
      if (show) this.show(show);
      if (goals) {
        this.goals = goals;
        this.clock = { now: time, read: performance.now() };
      }
      if (frame !== undefined) {
        this.frame = frame;
        for (const thing of this.things) thing.matrix = null;
      }
      this.tool.hidden = !this.goals.length || !this.frame; // a pose has a frame
      if (this.tool.hidden && this.isAiming) this.startAiming(false);
      if (frames) this.setFrames(frames);
      let isNew = false;
      for (const each of things ?? []) isNew = this.set(this.things[each.place], each) || isNew;
      const now = performance.now();
      const isLook = !this.isMoved && !this.followed && (isNew || now - (this.looked ?? 0) > LOOK);
      if (isLook) this.looked = now;
      if (isLook && (isNew || this.isOutgrown())) this.fit();
      this.canvas.dataset.events = Number(this.canvas.dataset.events ?? 0) + 1;
      this.renew();
    }

    show(list) {
      const known = new Map(this.things.map((each) => [each.href, each]));
      this.things = list.map((each, place) => ({ trace: [], ...known.get(each.href), ...each, colour: `--line-${place % SpaceView.COLOURS}` }));
      this.list();
      for (const thing of this.things) if (thing.history) this.recall(thing);
    }

    /* Whether something is drawn that was not before. */
    set(thing, { drawing, pose, problem, picture, in: frame }) {
      const isNew = pose !== null && !thing.matrix;
      if (drawing !== undefined) {
        thing.drawing = drawing;
        thing.frame = frame;
        thing.count = (thing.count ?? 0) + 1;
        if (drawing?.trace) this.trace(thing, drawing.arrows[0]);
      }
      if (picture) this.load(thing, picture);
      thing.matrix = pose && rows(pose);
      thing.why.textContent = problem;
      if (!thing.drawing || !thing.matrix) return false;
      thing.points = thing.drawing.points && projected(thing.matrix, thing.drawing.points);
      thing.line = thing.drawing.line && projected(thing.matrix, thing.drawing.line);
      if (thing.drawing.grid) {
        const { origin, size: [width, height] } = thing.drawing.grid, corner = rows(origin);
        thing.corners = [[0, 0], [width, 0], [width, height], [0, height]]
          .map(([x, y]) => at(thing.matrix, ...at(corner, x, y)));
      }
      return isNew;
    }

    /* Where it was, in the frame of its messages. */
    trace(thing, [x, y]) {
      const last = thing.trace.at(-1);
      if (last && Math.hypot(x - last[0], y - last[1]) < STEP) return;
      thing.trace.push([x, y]);
      if (thing.trace.length > TRACE) thing.trace = thing.trace.filter((_, place) => place % 2);
    }

    async recall(thing) {
      const history = thing.history;
      thing.history = "";
      try {
        const [xs, ys] = await Promise.all(["x", "y"].map(async (axis) => {
          const answer = await fetch(`${history}${axis}&from=-${PAST}&points=1000`, { headers: { accept: "application/json" } });
          const told = await answer.json();
          return told.mean ?? told.value ?? [];
        }));
        const past = xs.map((x, place) => [x, ys[place]]).filter((each) => each.every(Number.isFinite));
        thing.trace.unshift(...past.slice(-TRACE));
        this.renew();
      } catch {
        // not reachable, or not recorded any more: the trace begins now
      }
    }

    /* One picture of a grid at a time: the next is asked for when that is there. */
    load(thing, address) {
      thing.wanted = address;
      if (thing.isLoading) return;
      thing.isLoading = true;
      const image = new Image(), own = address;
      const done = () => {
        thing.isLoading = false;
        if (thing.wanted !== own) this.load(thing, thing.wanted);
      };
      image.addEventListener("load", () => {
        thing.image = image;
        thing.shade = null;
        done();
        this.renew();
      });
      image.addEventListener("error", () => {
        thing.why.textContent = "The picture of the grid cannot be loaded";
        done();
      });
      image.src = address;
    }

    /* What is drawn */

    resize() {
      const ratio = devicePixelRatio, { clientWidth, clientHeight } = this.canvas;
      this.canvas.width = Math.round(clientWidth * ratio);
      this.canvas.height = Math.round(clientHeight * ratio);
      if (!this.isMoved && !this.followed) this.fit();
      this.renew();
    }

    renew() {
      if (this.isStale) return;
      this.isStale = true;
      requestAnimationFrame(() => { this.isStale = false; this.draw(); });
    }

    draw() {
      const { canvas } = this, context = canvas.getContext("2d"), ratio = devicePixelRatio;
      const width = canvas.clientWidth, height = canvas.clientHeight;
      const followed = this.frames.get(this.followed);
      if (followed) this.centre = [followed.pose[0], followed.pose[1]];
      this.x = (x) => width / 2 + (x - this.centre[0]) * this.scale;
      this.y = (y) => height / 2 - (y - this.centre[1]) * this.scale;
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.fillStyle = colour(canvas, "--card");
      context.fillRect(0, 0, width, height);
      const shown = this.things.filter((each) => each.matrix && each.drawing && !each.isHidden);
      for (const thing of shown) if (thing.drawing.grid) this.drawGrid(context, thing, ratio);
      this.drawRule(context, width, height);
      for (const thing of shown) this.drawThing(context, thing);
      if (this.hasFrames) this.drawFrames(context);
      if (this.aim) this.drawAim(context);
      canvas.dataset.drawn = Number(canvas.dataset.drawn ?? 0) + 1;
      canvas.dataset.messages = this.things.reduce((sum, { count }) => sum + (count ?? 0), 0);
      canvas.dataset.things = shown.map(({ label }) => label).join(" ");
    }

    drawGrid(context, thing, ratio) {
      if (!thing.image) return;
      const { origin, size: [width, height] } = thing.drawing.grid;
      const m = thing.matrix, [x, y] = at(m, ...origin.slice(0, 3)), turned = rows(origin), s = this.scale * ratio;
      const right = [m[0] * turned[0] + m[1] * turned[4], m[4] * turned[0] + m[5] * turned[4]];
      const above = [m[0] * turned[1] + m[1] * turned[5], m[4] * turned[1] + m[5] * turned[5]];
      context.save();
      context.setTransform(right[0] * s, -right[1] * s, above[0] * s, -above[1] * s, this.x(x) * ratio, this.y(y) * ratio);
      context.imageSmoothingEnabled = (width / thing.image.naturalWidth) * this.scale < 1;
      /* The first row of a picture is its last in space; what the last squares jut out by is seen, and transparent. */
      const cell = Math.max(width / thing.image.naturalWidth, height / thing.image.naturalHeight);
      const tall = thing.image.naturalHeight * Math.min(cell, height / thing.image.naturalHeight * 1.01);
      context.scale(1, -1);
      context.drawImage(this.shade(thing), 0, -tall, width, tall);
      context.restore();
    }

    /* The picture in the colours of the page. */
    shade(thing) {
      if (!isDark.matches) return thing.image;
      if (!thing.shade) {
        thing.shade = element("canvas", { width: thing.image.naturalWidth, height: thing.image.naturalHeight });
        const context = thing.shade.getContext("2d");
        context.filter = "invert(0.86)";
        context.drawImage(thing.image, 0, 0);
      }
      return thing.shade;
    }

    /* Lines that are a round number of metres apart, and what that number is. */
    drawRule(context, width, height) {
      const least = 50 / this.scale, power = 10 ** Math.floor(Math.log10(least));
      const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= least);
      context.strokeStyle = colour(this.canvas, "--line");
      context.lineWidth = 1;
      context.globalAlpha = 0.7;
      context.beginPath();
      const [left, top] = [this.centre[0] - width / 2 / this.scale, this.centre[1] - height / 2 / this.scale];
      for (let x = Math.ceil(left / step) * step; this.x(x) < width; x += step) {
        context.moveTo(Math.round(this.x(x)) + 0.5, 0);
        context.lineTo(Math.round(this.x(x)) + 0.5, height);
      }
      for (let y = Math.ceil(top / step) * step; this.y(y) > 0; y += step) {
        context.moveTo(0, Math.round(this.y(y)) + 0.5);
        context.lineTo(width, Math.round(this.y(y)) + 0.5);
      }
      context.stroke();
      context.globalAlpha = 1;
      context.fillStyle = context.strokeStyle = colour(this.canvas, "--quiet");
      context.fillRect(10, height - 12, step * this.scale, 2);
      context.font = "12px sans-serif";
      context.textBaseline = "bottom";
      context.fillText(step < 1 ? `${Number((step * 100).toPrecision(3))} cm` : `${step.toLocaleString("en")} m`, 10, height - 14);
    }

    drawThing(context, thing) {
      const { matrix: m, drawing } = thing;
      context.strokeStyle = context.fillStyle = colour(this.canvas, thing.colour);
      context.lineWidth = 2;
      context.lineJoin = "round";
      if (thing.line) this.stroke(context, thing.line, drawing.line.closed);
      if (drawing.trace && thing.trace.length > 1) {
        context.globalAlpha = 0.55;
        this.stroke(context, new Float64Array(thing.trace.flatMap(([x, y]) => at(m, x, y))), false);
        context.globalAlpha = 1;
      }
      if (thing.points) {
        const size = thing.points.length > 2 ? 3 : 7;
        for (let each = 0; each < thing.points.length; each += 2) {
          context.fillRect(this.x(thing.points[each]) - size / 2, this.y(thing.points[each + 1]) - size / 2, size, size);
        }
      }
      if (drawing.ellipse) this.drawEllipse(context, thing);
      for (const arrow of drawing.arrows ?? []) this.drawArrow(context, m, arrow, drawing.arrows.length > 1);
    }

    stroke(context, points, isClosed) {
      context.beginPath();
      for (let each = 0; each < points.length; each += 2) context.lineTo(this.x(points[each]), this.y(points[each + 1]));
      if (isClosed) context.closePath();
      context.stroke();
    }

    /* An arrow as long on the screen however near one is. */
    drawArrow(context, m, pose, isOneOfMany) {
      const turned = rows(pose), [x, y] = at(m, pose[0], pose[1], pose[2]);
      const [tx, ty] = at(m, pose[0] + turned[0], pose[1] + turned[4], pose[2]);
      const angle = Math.atan2(ty - y, tx - x), size = isOneOfMany ? 6 : 12;
      const corner = (turn, far) => [this.x(x) + far * Math.cos(angle + turn), this.y(y) - far * Math.sin(angle + turn)];
      context.beginPath();
      for (const [turn, far] of [[0, size * 1.4], [2.5, size], [Math.PI, size * 0.45], [-2.5, size]]) context.lineTo(...corner(turn, far));
      context.closePath();
      context.fill();
    }

    /* The pose that is being chosen. */
    drawAim(context) {
      const { x, y, heading } = this.aim, half = heading / 2;
      context.strokeStyle = context.fillStyle = colour(this.canvas, "--bad");
      context.beginPath();
      context.arc(this.x(x), this.y(y), 5, 0, 2 * Math.PI);
      context.moveTo(this.x(x), this.y(y));
      const tip = [x + (30 / this.scale) * Math.cos(heading), y + (30 / this.scale) * Math.sin(heading)];
      context.lineTo(this.x(tip[0]), this.y(tip[1]));
      context.stroke();
      this.drawArrow(context, rows([0, 0, 0, 0, 0, 0, 1]), [...tip, 0, 0, 0, Math.sin(half), Math.cos(half)], false);
    }

    drawEllipse(context, { matrix: m, drawing }) {
      const [major, minor, angle] = drawing.ellipse, [x, y] = at(m, ...drawing.arrows[0]);
      const turn = Math.atan2(m[4], m[0]) + angle;
      if (major * this.scale > 20000) return;
      context.globalAlpha = 0.18;
      context.beginPath();
      context.ellipse(this.x(x), this.y(y), major * this.scale, minor * this.scale, -turn, 0, 2 * Math.PI);
      context.fill();
      context.globalAlpha = 1;
    }

    drawFrames(context) {
      const length = 18, drawn = [];
      context.lineWidth = 2;
      context.font = "11px sans-serif";
      context.textBaseline = "middle";
      for (const { name, pose } of this.frames.values()) {
        const m = rows(pose), x = this.x(pose[0]), y = this.y(pose[1]);
        for (const [axis, tone] of [[0, "--bad"], [1, "--good"]]) {
          context.strokeStyle = colour(this.canvas, tone);
          context.beginPath();
          context.moveTo(x, y);
          context.lineTo(x + m[axis] * length, y - m[axis + 4] * length);
          context.stroke();
        }
        /* Names of frames that lie on each other stand below each other. */
        let line = y - 8;
        while (drawn.some(([left, top]) => Math.abs(left - x) < 70 && Math.abs(top - line) < 12)) line += 12;
        drawn.push([x, line]);
        context.lineWidth = 3;
        context.strokeStyle = colour(this.canvas, "--card");
        context.strokeText(name, x + 8, line);
        context.lineWidth = 2;
        context.fillStyle = colour(this.canvas, "--ink");
        context.fillText(name, x + 8, line);
      }
    }
  }

  SpaceView.watch("space", View);
}
