/* Shows, of the folded things of a page, those whose words hold what is typed.

Without this file, or with scripts off, there is no field to type in, and everything can be unfolded by hand. What a URL
names by its fragment is unfolded in browsers that do not do so by themselves. */
"use strict";
{
  const field = document.querySelector(".filter"), box = field?.querySelector("input");
  const groups = [...document.querySelectorAll("details.group")];
  const things = groups.map((group) => [...group.querySelectorAll("details.thing")]);
  const words = things.map((each) => each.map((thing) => thing.textContent.toLowerCase()));

  const filter = () => {
    const wanted = box.value.toLowerCase().split(/\s+/).filter(Boolean);
    groups.forEach((group, place) => {
      let found = 0;
      things[place].forEach((thing, index) => {
        thing.hidden = !wanted.every((word) => words[place][index].includes(word));
        if (!thing.hidden) found += 1;
      });
      group.hidden = !found;
      group.open = Boolean(wanted.length && found);
      group.querySelector(".count").textContent = found.toLocaleString("en");
    });
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
  }
  addEventListener("hashchange", reveal);
  reveal();
}
