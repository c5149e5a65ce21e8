/* Shows, of the folded things of a page, those whose words hold what is typed.

Without this file, or with scripts off, there is no field to type in, and everything can be unfolded by hand. What a URL
names by its fragment is unfolded in browsers that do not do so by themselves. A page that is kept up to date is filtered
again when something in it has changed; what is filtered out is marked by an attribute that live.js leaves alone. */
"use strict";
{
  const field = document.querySelector(".filter"), box = field?.querySelector("input");
  const OUT = "data-filtered";

  const things = (group) => [...group.querySelectorAll("details.thing, tbody > tr, ul.acts > li")];

  const mark = (element, isOut) => element.toggleAttribute(OUT, isOut);

  const tell = (element, text) => { if (element.textContent !== text) element.textContent = text; };

  let wasWanted = false;

  const filter = () => {
    const wanted = box.value.toLowerCase().split(/\s+/).filter(Boolean);
    if (!wanted.length && !wasWanted) return;
    for (const group of document.querySelectorAll("details.group")) {
      let found = 0;
      for (const thing of things(group)) {
        const text = thing.textContent.toLowerCase();
        const isFound = wanted.every((word) => text.includes(word));
        mark(thing, !isFound);
        if (isFound) found += 1;
      }
      mark(group, !found);
      if (wanted.length) group.open = Boolean(found);
      else if (wasWanted) group.open = false;
      tell(group.querySelector(".count"), found.toLocaleString("en"));
    }
    wasWanted = Boolean(wanted.length);
  };

  const reveal = () => {
    const named = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!named) return;
    for (let above = named; above; above = above.parentElement) if (above.matches("details")) above.open = true;
    named.scrollIntoView();
  };

  if (field) {
    field.hidden = false;
    box.addEventListener("input", filter);
    let due = 0;
    new MutationObserver(() => {
      cancelAnimationFrame(due);
      due = requestAnimationFrame(() => wasWanted && filter());
    }).observe(document.querySelector("main"), { childList: true, subtree: true });
  }
  addEventListener("hashchange", reveal);
  reveal();
}
