/* What views of space have alike, from above and in three dimensions.

A view lists its topics, and is followed while it is in the window and the page is not hidden. What extends SpaceView
builds `words` and `legend`, takes events (`take`), and draws (`renew`). */
"use strict";
class SpaceView {
  static COLOURS = 8; // that the stylesheet has: --line-0 and so on
  static AGAIN = 4000; // milliseconds before a stream that was refused is asked for again

  constructor(figure, address) {
    this.figure = figure;
    this.address = address;
    this.things = [];
    this.frames = new Map();
    this.followed = ""; // the name of the frame that stays in the middle
    this.isMoved = false; // by hand: then it stays where it is
    this.isSeen = false;
    this.isStale = false;
  }

  static element(name, values = {}, ...children) {
    const made = Object.assign(document.createElement(name), values);
    made.append(...children);
    return made;
  }

  static button(text, label, act) {
    const made = SpaceView.element("button", { type: "button", textContent: text, ariaLabel: label });
    made.addEventListener("click", act);
    return made;
  }

  open() {
    this.stream?.close();
    const stream = this.stream = new EventSource(this.address);
    stream.addEventListener("message", (event) => this.take(JSON.parse(event.data)));
    stream.addEventListener("open", () => this.say("Live"));
    stream.addEventListener("error", () => {
      this.say("Not live");
      if (stream.readyState !== EventSource.CLOSED) return;
      clearTimeout(this.again);
      this.again = setTimeout(() => this.follow(), SpaceView.AGAIN);
    });
  }

  close() {
    clearTimeout(this.again);
    this.stream?.close();
    this.stream = null;
  }

  say(words) {
    if (this.words.textContent !== words) this.words.textContent = words;
  }

  follow() {
    const isFollowed = this.isSeen && !document.hidden;
    if (isFollowed && (!this.stream || this.stream.readyState === EventSource.CLOSED)) this.open();
    if (!isFollowed) this.close();
  }

  /* The topics, each with its colour, a tick that shows or hides it, and why nothing is drawn of it. */
  list() {
    const { element } = SpaceView;
    this.legend.replaceChildren(...this.things.map((thing) => {
      const tick = element("input", { type: "checkbox", checked: !thing.isHidden });
      tick.addEventListener("change", () => {
        thing.isHidden = !tick.checked;
        this.toggle(thing);
        this.renew();
      });
      const mark = element("span", { className: "mark" });
      mark.style.background = `var(${thing.colour})`;
      thing.why = element("span", { className: "why" });
      return element("li", {}, element("label", { className: "tick", ariaLabel: thing.label }, tick, mark),
        element("a", { href: thing.href, textContent: thing.label }),
        element("span", { className: "sort", textContent: thing.kind }), thing.why);
    }));
  }

  /* The choice of a frame to be followed. */
  chooseFollowed() {
    const { element } = SpaceView;
    this.choice = element("select", {}, element("option", { value: "", textContent: "nothing" }));
    this.choice.addEventListener("change", () => { this.followed = this.choice.value; this.renew(); });
    return element("label", {}, "Follow ", this.choice);
  }

  followNothing() {
    this.followed = this.choice.value = "";
  }

  setFrames(frames) {
    const names = frames.map(({ name }) => name);
    if (names.join("\n") !== [...this.frames.keys()].join("\n")) {
      const option = (name) => SpaceView.element("option", { value: name, textContent: name || "nothing" });
      this.choice.replaceChildren(...["", ...names].map(option));
      this.choice.value = names.includes(this.followed) ? this.followed : "";
    }
    this.frames = new Map(frames.map((each) => [each.name, each]));
  }

  /* After a topic was shown or hidden. */
  toggle() {}

  /* Make a view of each element that has data-NAME, the address of its stream; of those that come later, too. */
  static watch(name, View) {
    const views = new Map();
    const observer = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const view = views.get(target);
        if (!view) continue;
        view.isSeen = isIntersecting;
        view.follow();
      }
    });
    const look = () => {
      for (const figure of document.querySelectorAll(`[data-${name}]`)) {
        if (views.has(figure)) continue;
        views.set(figure, new View(figure, figure.dataset[name]));
        observer.observe(figure);
      }
      for (const [figure, view] of views) {
        if (figure.isConnected) continue;
        view.close();
        observer.unobserve(figure);
        views.delete(figure);
      }
    };
    document.addEventListener("visibilitychange", () => views.forEach((view) => view.follow()));
    addEventListener("pagehide", () => views.forEach((view) => view.close()));
    addEventListener("pageshow", (event) => event.persisted && views.forEach((view) => view.follow()));
    new MutationObserver(look).observe(document.querySelector("main"), { childList: true, subtree: true });
    look();
  }
}
