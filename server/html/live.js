/* Keeps a page up to date while it is looked at.

The resource of the page is followed by its event stream, each event of which is the page as it is then. What differs
is changed in place, and nothing else is touched: focus, scroll position, what is unfolded, what is typed. Whatever
comes is parsed apart from the page (DOMParser runs and loads nothing) and taken over node by node.

Without this file, or with scripts off, the page is what it was when it was loaded. */
"use strict";
{
  const FIRST_WAIT = 1000, LONGEST_WAIT = 30000; // milliseconds before the stream is opened anew; each time twice as long
  const PATIENCE = 2000; // so long a lost stream is not worth a word
  const MARKED = 900, FADING = 1000; // so long a changed value stands out, and goes back to what it was
  const AT_REST = 700; // so long a button that has just come cannot be pressed by mistake for another
  const BYTES = 300000; // of pages a second at most: a large page comes less often

  /* A field of a form shadows the form's own properties (`<input name="firstChild">`), and fields are named by robots.
  So nodes are asked through their classes. */
  const read = (kind, name) => {
    const { get } = Object.getOwnPropertyDescriptor(kind.prototype, name);
    return (node) => get.call(node);
  };
  const call = (kind, name) => {
    const method = kind.prototype[name];
    return (node, ...given) => method.apply(node, given);
  };
  const nameOf = read(Node, "nodeName"), typeOf = read(Node, "nodeType"), parentOf = read(Node, "parentElement");
  const nodesOf = read(Node, "childNodes"), firstOf = read(Node, "firstChild"), nextOf = read(Node, "nextSibling");
  const insert = call(Node, "insertBefore"), remove = call(Node, "removeChild"), matches = call(Element, "matches");
  const attributesOf = read(Element, "attributes"), attribute = call(Element, "getAttribute");
  const set = call(Element, "setAttribute"), unset = call(Element, "removeAttribute");
  const find = call(Element, "querySelector"), all = call(Element, "querySelectorAll");
  const isElement = (node) => typeOf(node) === Node.ELEMENT_NODE;

  /* What is typed */

  const touched = new WeakSet();
  document.addEventListener("input", (event) => touched.add(event.target.form ?? event.target));

  function isChanged(field) {
    if (field.type === "hidden") return false;
    if (field.type === "checkbox") return field.checked !== field.defaultChecked;
    if (field.localName === "select") return [...field.options].some((each) => each.selected !== each.defaultSelected);
    return field.value !== field.defaultValue && field.value !== "";
  }

  /* Whether somebody fills in a form. What was typed into is theirs until the page is left. */
  function isHeld(form) {
    const active = document.activeElement;
    if (touched.has(form) || (active?.form === form && !active.matches("button"))) return true;
    return [...all(form, "input, select, textarea")].some(isChanged);
  }

  const heldIn = (element) =>
    [...(matches(element, "form") ? [element] : []), ...all(element, "form")].filter(isHeld);

  /* One page becoming the next */

  /* The children by names that are the same in both pages: their own, or their place after one that has such a name. */
  function named(parent) {
    const found = new Map(), counts = new Map();
    let after = "";
    for (const node of nodesOf(parent)) {
      const own = isElement(node)
        && (attribute(node, "data-key") ?? attribute(node, "id") ?? attribute(node, "aria-labelledby"));
      if (own) after = own;
      const name = `${nameOf(node)} ${own ? "is" : "after"} ${after}`;
      const count = counts.get(name) ?? 0;
      counts.set(name, count + 1);
      found.set(`${name} ${count}`, node);
    }
    return found;
  }

  function mergeChildren(old, now) {
    const mine = named(old), theirs = named(now), kept = new Set();
    for (const [name, node] of mine) if (!theirs.has(name) && !dropped(old, node)) kept.add(node);
    let at = firstOf(old);
    for (const [name, node] of theirs) {
      while (kept.has(at)) at = nextOf(at);
      const own = mine.get(name);
      if (own && own === at) at = nextOf(at);
      else insert(old, own ?? arrived(node), at);
      if (own) merge(own, node);
    }
  }

  function merge(old, now) {
    if (!isElement(old)) {
      if (old.nodeValue === now.nodeValue) return;
      old.nodeValue = now.nodeValue;
      pointOut(parentOf(old));
    } else if (matches(old, "form") && isHeld(old)) {
      renew(old, now);
    } else {
      mergeAttributes(old, now);
      if (!matches(old, "[data-drive], [data-plot], [data-space], a.plot")) mergeChildren(old, now); // what stands in these is their scripts'
    }
  }

  function mergeAttributes(old, now) {
    const isOurs = (name) =>
      name === "data-changed" || name === "data-filtered" || name === "data-ago" || name === "inert" ||
      (matches(old, "img[data-motion]") && ["src", "data-still", "data-moving"].includes(name)) ||
      (name === "open" && matches(old, "details")) || (name === "hidden" && matches(old, ".filter"));
    for (const { name, value } of attributesOf(now))
      if (!isOurs(name) && attribute(old, name) !== value) set(old, name, value);
    for (const { name } of [...attributesOf(old)])
      if (!isOurs(name) && attribute(now, name) === null) unset(old, name);
  }

  /* Of a form that is held only what is not seen changes: the proof of where it comes from. */
  function renew(old, now) {
    unset(old, "data-withdrawn");
    for (const field of all(old, "input[type=hidden]")) {
      const fresh = [...all(now, "input[type=hidden]")].find((each) => each.name === field.name);
      if (fresh) field.value = fresh.value;
    }
  }

  /* Take a node away, unless a form that is held stands in it. */
  function dropped(parent, node) {
    const held = isElement(node) ? heldIn(node) : [];
    for (const form of held) set(form, "data-withdrawn", "");
    if (!held.length) remove(parent, node);
    return !held.length;
  }

  /* A node as part of this page. Nobody has seen its buttons yet, so for a moment they do nothing. */
  function arrived(node) {
    const own = document.importNode(node, true);
    if (isElement(own) && (matches(own, "form") || find(own, "form"))) {
      set(own, "inert", "");
      setTimeout(() => unset(own, "inert"), AT_REST);
    }
    return own;
  }

  const fading = new WeakMap();
  function pointOut(element) {
    if (!element || !matches(element, ".value")) return;
    const later = (milliseconds, then) => fading.set(element, setTimeout(then, milliseconds));
    clearTimeout(fading.get(element));
    set(element, "data-changed", "now");
    later(MARKED, () => {
      set(element, "data-changed", "past");
      later(FADING, () => unset(element, "data-changed"));
    });
  }

  function show(text) {
    const page = new DOMParser().parseFromString(text, "text/html");
    for (const part of document.querySelectorAll("[data-live]")) {
      const now = page.querySelector(part.localName);
      if (now) mergeChildren(part, now);
    }
    document.dispatchEvent(new Event("shown"));
    if (!page.querySelector("main[data-live]")) end();
  }

  /* A notice that is not the server's; the next page takes it away. */
  function notice(text) {
    const old = document.getElementById("live-notice");
    const box = old ?? document.createElement("div");
    box.id = "live-notice";
    box.className = "notice warning";
    if (!old) document.querySelector("main header.title").after(box);
    if (box.textContent !== text) box.replaceChildren(Object.assign(document.createElement("p"), { textContent: text }));
  }

  /* The mark */

  const mark = document.querySelector(".liveness");
  const words = mark.querySelector("[role=status]"), button = mark.querySelector("button");

  function say(state) {
    if (mark.dataset.state === state) return;
    mark.dataset.state = state;
    mark.hidden = false;
    words.textContent = { live: "Live", lost: "Not live", paused: "Paused", gone: "Gone" }[state];
    button.textContent = state === "paused" ? "Go on" : "Pause";
  }

  button.addEventListener("click", () => {
    isPaused = !isPaused;
    if (isPaused) say("paused");
    isPaused ? close() : open();
  });

  /* The stream */

  let stream = null, isPaused = false, isOver = false, wait = FIRST_WAIT, again = 0, worry = 0;

  function address() {
    const url = new URL(location.href);
    const rate = Math.min(Number(document.querySelector("main").dataset.live), BYTES / document.body.outerHTML.length);
    url.hash = "";
    url.searchParams.set("format", "html");
    url.searchParams.set("rate", Math.max(rate, 0.05).toFixed(3));
    return url;
  }

  function open() {
    close();
    if (isPaused || isOver || document.hidden) return;
    const own = (stream = new EventSource(address()));
    own.addEventListener("open", () => {
      clearTimeout(worry);
      worry = 0;
      wait = FIRST_WAIT;
      say("live");
    });
    own.addEventListener("message", (event) => {
      say("live");
      show(event.data);
    });
    own.addEventListener("gone", (event) => absent(problemIn(event.data)));
    own.addEventListener("problem", (event) => {
      say("live");
      notice(`This cannot be read now. ${problemIn(event.data).detail ?? ""}`);
    });
    own.addEventListener("error", () => {
      const isRefused = own.readyState === EventSource.CLOSED;
      close();
      worry ||= setTimeout(() => isPaused || isOver || say("lost"), PATIENCE);
      again = setTimeout(open, wait * (0.75 + Math.random() / 2));
      wait = Math.min(wait * 2, LONGEST_WAIT);
      if (isRefused) ask();
    });
  }

  function close() {
    clearTimeout(again);
    stream?.close();
    stream = null;
  }

  /* Nothing will come any more: what is shown is final. */
  function end() {
    isOver = true;
    close();
    mark.hidden = true;
  }

  function problemIn(text) {
    try {
      return JSON.parse(text);
    } catch {
      return {};
    }
  }

  function absent({ status, detail }) {
    say("gone");
    notice(`This resource is gone. The page shows its last state. ${detail ?? ""}`);
    if (status === 410) end();
  }

  /* An EventSource does not tell why it was refused. */
  async function ask() {
    try {
      const answer = await fetch(location.href, { method: "HEAD", headers: { Accept: "text/html" } });
      if (answer.status === 404 || answer.status === 410) absent({ status: answer.status });
    } catch {
      // not reachable: the mark says so
    }
  }

  document.addEventListener("visibilitychange", () => {
    wait = FIRST_WAIT;
    document.hidden ? close() : open();
  });
  addEventListener("pagehide", close);
  addEventListener("pageshow", (event) => event.persisted && open());

  open();
}
