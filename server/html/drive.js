/* Drives a robot from the page of a topic that commands its velocity.

A command is held (POST with a rate and a short lease) only while the pad is pressed: by a pointer or a finger, by keys, or
by the stick of a game pad. Meanwhile the lease is renewed a few times a second, with the command where that is another one.
Letting go deletes the hold. Whatever else ends, the page, the browser, the network, lets the lease lapse. Either way the
server then publishes zero.

Without this file, or with scripts off, there is no pad, and the form beside it holds a command by its numbers. */
"use strict";
{
  const RENEWALS = 4; // a lease is renewed so often that this many would fit into it
  const SPACING = 80; // milliseconds between two commands at least
  const AT_REST = 0.15; // a stick that is nearer to its middle is not pressed
  const BEGINNING = 0.3; // of the range: how fast the pad goes before somebody says otherwise
  const PATIENCE = 5000; // milliseconds that a first command may take: it waits for a subscriber
  const KEYS = {
    ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [1, 0], ArrowRight: [-1, 0],
    KeyW: [0, 1], KeyS: [0, -1], KeyA: [1, 0], KeyD: [-1, 0],
  };

  /* An element with attributes, properties that begin with a dot, and children. */
  function element(name, given = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(given))
      key.startsWith(".") ? (made[key.slice(1)] = value) : made.setAttribute(key, value);
    made.append(...children);
    return made;
  }

  /* What is pressed as [left, ahead], each from -1 to 1 and both within a circle. */
  function within([left, ahead]) {
    const length = Math.hypot(left, ahead);
    return length > 1 ? [left / length, ahead / length] : [left, ahead];
  }

  class Refused extends Error {}

  class Pad {
    #pointer = null; // which, and where
    #keys = new Set();
    #stick = null; // of a game pad
    #isLocked = false; // after a failure, until all is let go
    #isDriving = false;
    #hold = null; // its path
    #ending = Promise.resolve(); // of the last hold
    #wake = () => {};
    #frame = 0;

    constructor(box, number) {
      this.box = box;
      this.told = box.dataset.drive;
      this.config = JSON.parse(this.told);
      this.#draw(number);
      this.#listen();
    }

    #draw(number) {
      const { ahead, left, topic } = this.config;
      this.knob = element("div", { class: "knob" });
      this.pad = element("div", {
        class: "stick", tabindex: "0", role: "application", "aria-roledescription": "drive pad",
        "aria-label": `Drive ${topic}`, "aria-describedby": `drive-hint-${number}`,
      }, this.knob);
      this.speed = this.#slider(ahead, `drive-speed-${number}`);
      this.turn = this.#slider(left, `drive-turn-${number}`);
      this.words = element("p", { role: "status", class: "driving", ".textContent": "Standing" });
      this.figures = element("p", { class: "figures", "aria-hidden": "true", ".textContent": this.#figures([0, 0]) });
      const hint = element("p", { class: "hint", id: `drive-hint-${number}`, ".textContent":
        "Press and hold the pad. While it has the focus, arrow keys, W A S D and the left stick of a game pad drive too. "
        + "The robot stops when you let go, leave the page, or lose the connection." });
      const reins = element("div", { class: "reins" }, this.speed.row, this.turn.row, this.words, this.figures, hint);
      this.box.replaceChildren(this.pad, reins);
    }

    /* How fast the pad goes at its edge. */
    #slider({ label, unit, least, greatest }, id) {
      const most = Math.max(Math.abs(least), Math.abs(greatest));
      const input = element("input", {
        type: "range", id, min: most / 20, max: most, step: most / 20, ".value": most * BEGINNING,
      });
      const shown = element("output", { for: id });
      const show = () => {
        shown.textContent = `${Number(input.value).toPrecision(2)} ${unit}`;
        input.setAttribute("aria-valuetext", shown.textContent);
      };
      input.addEventListener("input", () => (show(), this.#changed()));
      show();
      return { row: element("p", {}, element("label", { for: id, ".textContent": label }), input, shown), input };
    }

    #listen() {
      const { pad } = this;
      pad.addEventListener("pointerdown", (event) => {
        if (this.#pointer || event.button !== 0) return;
        event.preventDefault();
        pad.setPointerCapture(event.pointerId);
        pad.focus({ preventScroll: true });
        this.#point(event);
      });
      pad.addEventListener("pointermove", (event) => event.pointerId === this.#pointer?.id && this.#point(event));
      for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
        pad.addEventListener(name, (event) => {
          if (event.pointerId !== this.#pointer?.id) return;
          this.#pointer = null;
          this.#changed();
        });
      pad.addEventListener("contextmenu", (event) => event.preventDefault());
      pad.addEventListener("keydown", (event) => {
        if (event.code === "Escape") this.release();
        if (!(event.code in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        if (event.repeat) return;
        this.#keys.add(event.code);
        this.#changed();
      });
      pad.addEventListener("keyup", (event) => this.#keys.delete(event.code) && this.#changed());
      pad.addEventListener("focus", () => this.#poll());
      pad.addEventListener("blur", () => {
        this.#keys.clear();
        this.#stick = null;
        this.#changed();
      });
    }

    #point(event) {
      const { left, top, width, height } = this.pad.getBoundingClientRect();
      const at = [1 - (2 * (event.clientX - left)) / width, 1 - (2 * (event.clientY - top)) / height];
      this.#pointer = { id: event.pointerId, at };
      this.#changed();
    }

    /* The left stick of the first game pad, as long as the pad has the focus. */
    #poll() {
      cancelAnimationFrame(this.#frame);
      if (document.activeElement !== this.pad) return;
      const found = [...(navigator.getGamepads?.() ?? [])].find((each) => each?.connected && each.axes.length > 1);
      const at = found && [-found.axes[0], -found.axes[1]];
      const now = at && Math.hypot(...at) > AT_REST ? at : null;
      if (String(now) !== String(this.#stick)) {
        this.#stick = now;
        this.#changed();
      }
      this.#frame = requestAnimationFrame(() => this.#poll());
    }

    /* Let go of everything: nothing drives on before it is pressed anew. */
    release() {
      this.#pointer = null;
      this.#keys.clear();
      this.#isLocked = this.#stick !== null;
      this.#changed();
    }

    get #pressed() {
      if (this.#pointer) return this.#pointer.at;
      if (this.#keys.size) return [0, 1].map((axis) => [...this.#keys].reduce((sum, key) => sum + KEYS[key][axis], 0));
      return this.#stick;
    }

    get #isPressed() {
      return this.#pressed !== null && !this.#isLocked;
    }

    #changed() {
      if (this.#pressed === null) this.#isLocked = false;
      const at = this.#isPressed ? within(this.#pressed) : [0, 0];
      this.knob.style.translate = `${-at[0] * 100}% ${-at[1] * 100}%`;
      this.pad.toggleAttribute("data-pressed", this.#isPressed);
      this.figures.textContent = this.#figures(at);
      if (!this.#isPressed) this.#end();
      else if (!this.#isDriving) this.#drive();
      this.#wake();
    }

    /* The speeds of a place of the knob, within their ranges. */
    #speeds([toLeft, toFront]) {
      const { ahead, left } = this.config;
      const fit = (part, slider, { least, greatest }) =>
        part === 0 ? 0 : Math.min(Math.max(part * Number(slider.input.value), Math.min(least, 0)), Math.max(greatest, 0));
      return [fit(toFront, this.speed, ahead), fit(toLeft, this.turn, left)];
    }

    #figures(at) {
      const [speed, turn] = this.speed ? this.#speeds(at) : [0, 0];
      return `${speed.toFixed(2)} ${this.config.ahead.unit}, ${turn.toFixed(2)} ${this.config.left.unit}`;
    }

    #message() {
      const message = structuredClone(this.config.zero);
      const speeds = this.#speeds(within(this.#pressed));
      [this.config.ahead, this.config.left].forEach(({ path }, index) => {
        const names = path.split("."), last = names.pop();
        names.reduce((inner, name) => inner[name], message)[last] = speeds[index];
      });
      return JSON.stringify(message);
    }

    /* Hold what is pressed, for as long as it is. */
    async #drive() {
      this.#isDriving = true;
      let told = "";
      try {
        while (this.#isPressed) {
          const message = this.#message();
          if (!this.#hold) await this.#begin(message);
          else await this.#renew(message === told ? "" : message);
          told = message;
          await this.#pause(told);
        }
      } catch (error) {
        const lost = "No answer: the robot has stopped, or stops when its lease expires";
        this.#fail(error instanceof Refused ? error.message : lost);
      } finally {
        this.#isDriving = false;
        this.#end();
      }
    }

    async #begin(message) {
      const { rate, lease } = this.config;
      await this.#ending; // nobody may hold what is held, not even who held it
      if (!this.#isPressed) return;
      const path = `${this.config.path || location.pathname}?rate=${rate}&lease=${lease}&then=zero`;
      const answer = await this.#ask("POST", path, message, PATIENCE);
      if (answer.status !== 201) throw new Refused(await reason(answer));
      this.#hold = new URL(answer.headers.get("location"), location.href).pathname;
      if (!this.#isPressed) return this.#end(); // let go meanwhile
      this.#say("Driving", true);
    }

    /* Renew the lease. A hold that has ended is begun again, unless what ended it refuses that. */
    async #renew(message) {
      const own = this.#hold;
      const answer = await this.#ask("PATCH", own, message, this.config.lease * 1000);
      if (answer.ok || this.#hold !== own) return;
      this.#hold = null;
      if (answer.status !== 410) throw new Refused(await reason(answer));
    }

    /* Until it is let go, another command is due, or the lease has to be renewed. */
    async #pause(told) {
      const until = (milliseconds) => new Promise((resolve) => {
        const timer = setTimeout(resolve, milliseconds);
        this.#wake = () => (this.#isPressed && this.#message() === told) || (clearTimeout(timer), resolve());
      });
      const begun = performance.now();
      await until((this.config.lease * 1000) / RENEWALS);
      const left = SPACING - (performance.now() - begun);
      if (this.#isPressed && left > 0) await new Promise((resolve) => {
        const timer = setTimeout(resolve, left);
        this.#wake = () => this.#isPressed || (clearTimeout(timer), resolve());
      });
      this.#wake = () => {};
    }

    #end() {
      const own = this.#hold;
      if (!own) return;
      this.#hold = null;
      this.#ending = this.#ask("DELETE", own, "", PATIENCE).catch(() => {}); // the lease ends it in any case
      if (this.words.dataset.tone !== "error") this.#say("Standing");
    }

    #fail(words) {
      this.#say(words, false, "error");
      this.#isLocked = this.#stick !== null;
      this.#pointer = null;
      this.#keys.clear();
      this.#changed();
    }

    #say(words, isDriving = false, tone = "") {
      this.words.textContent = words;
      this.words.dataset.tone = tone;
      this.words.toggleAttribute("data-driving", isDriving);
    }

    #ask(method, path, body, milliseconds) {
      const headers = { Accept: "application/json", Prefer: "return=minimal" };
      if (body) headers["Content-Type"] = "application/json";
      return fetch(path, {
        method, headers, body: body || null, keepalive: method === "DELETE", signal: AbortSignal.timeout(milliseconds),
      });
    }
  }

  async function reason(answer) {
    try {
      const said = await answer.json();
      const words = said.robotSaid ?? said.holder ?? said.agentSaid;
      return words === undefined ? said.detail : `${said.detail} “${words}”`;
    } catch {
      return `The server answered ${answer.status}`;
    }
  }

  const pads = new Set();
  let count = 0;

  /* Make the pads that have come with the page, or since; let go of those that have gone with what was on offer, or for
  which other limits hold now. */
  function look() {
    for (const pad of pads)
      if (!pad.box.isConnected || pad.box.dataset.drive !== pad.told) {
        pads.delete(pad);
        pad.release();
        pad.box.replaceChildren();
      }
    for (const box of document.querySelectorAll("[data-drive]"))
      if (!box.firstElementChild) pads.add(new Pad(box, (count += 1)));
  }

  new MutationObserver(look).observe(document.querySelector("main"), {
    childList: true, subtree: true, attributeFilter: ["data-drive"],
  });
  const letGo = () => pads.forEach((pad) => pad.release());
  addEventListener("blur", letGo);
  addEventListener("pagehide", letGo);
  document.addEventListener("visibilitychange", () => document.hidden && letGo());
  look();
}
