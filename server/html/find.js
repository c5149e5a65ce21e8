/* Shows what is found while words are typed into the box at the top of a page: the first results, as links below it.

Without this file, or with scripts off, the box leads to the page of the search. What a robot calls things is text here. */
"use strict";
{
  const WAIT = 150; // milliseconds after a key, so that a word is searched for and not each of its letters
  const SHOWN = 8;
  const form = document.querySelector("form.find"), box = form.querySelector("input");
  const list = document.createElement("ul");
  let timer, asked;

  const close = () => { list.hidden = true; };

  const element = (name, text, look) => {
    const made = document.createElement(name);
    made.textContent = text;
    if (look) made.className = look;
    return made;
  };

  /* The page may have been opened by another name of the server than the one in its URLs. */
  const here = (url) => {
    const { pathname, search } = new URL(url);
    return pathname + search;
  };

  const item = ({ name, url, kind, type }) => {
    const made = document.createElement("li"), link = document.createElement("a");
    link.href = here(url);
    link.append(element("bdi", name ?? here(url)), " ", element("span", typeof type === "string" ? type : kind, "hint"));
    made.append(link);
    return made;
  };

  const show = ({ query, total, results }) => {
    const items = results.slice(0, SHOWN).map(item);
    if (total > items.length) {
      const all = element("a", `All ${total.toLocaleString("en")}`), last = document.createElement("li");
      all.href = `${form.getAttribute("action")}?q=${encodeURIComponent(query)}`;
      last.append(all);
      items.push(last);
    }
    list.replaceChildren(...(items.length ? items : [element("li", "No result contains all of these words.", "none")]));
    list.hidden = false;
  };

  const search = async () => {
    asked?.abort();
    const words = box.value.trim();
    if (!words) return close();
    asked = new AbortController();
    const { signal } = asked;
    try {
      const url = `${form.getAttribute("action")}?q=${encodeURIComponent(words)}`;
      const answer = await fetch(url, { headers: { accept: "application/json" }, signal });
      if (answer.ok) show(await answer.json());
    } catch {
      if (!signal.aborted) close(); // the server has gone: the form says so when it is sent
    }
  };

  const links = () => [...list.querySelectorAll("a")];

  list.className = "suggestions";
  list.setAttribute("aria-label", "Found");
  list.hidden = true;
  form.append(list);
  box.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(search, WAIT);
  });
  form.addEventListener("submit", () => clearTimeout(timer));
  form.addEventListener("keydown", (event) => {
    const at = links().indexOf(document.activeElement);
    if (event.key === "Escape") close();
    else if (event.key === "ArrowDown" && !list.hidden) links()[Math.min(at + 1, links().length - 1)]?.focus();
    else if (event.key === "ArrowUp" && at >= 0) (links()[at - 1] ?? box).focus();
    else return;
    event.preventDefault();
  });
  addEventListener("click", (event) => { if (!form.contains(event.target)) close(); });
}
