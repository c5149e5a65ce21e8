/* Draws beside each number of a page how it was lately: each time the page is kept up to date, one point more.

Without this file the mark beside a number is a link to its plot all the same. */
"use strict";
{
  const KEPT = 60, WIDTH = 48, HEIGHT = 14;
  const NAMESPACE = "http://www.w3.org/2000/svg";
  const numbers = new Map(); // by the address of the plot

  function look() {
    const links = document.querySelectorAll("main a.plot");
    for (const link of links) {
      const before = link.previousElementSibling, address = link.getAttribute("href");
      const shown = before.matches(".unit") ? before.previousElementSibling : before;
      const number = Number(shown.getAttribute("title") ?? shown.textContent);
      if (!Number.isFinite(number)) continue;
      const kept = numbers.get(address) ?? [];
      numbers.set(address, kept);
      kept.push(number);
      if (kept.length > KEPT) kept.shift();
      if (kept.length > 1) draw(link, kept);
    }
  }

  function draw(link, kept) {
    const least = Math.min(...kept), most = Math.max(...kept), room = most - least || 1;
    const across = (at) => ((WIDTH * (KEPT - kept.length + at)) / (KEPT - 1)).toFixed(1);
    const up = (number) => (most === least ? HEIGHT / 2 : 1 + (HEIGHT - 2) * (1 - (number - least) / room)).toFixed(1);
    const line = link.querySelector("polyline") ?? picture(link);
    line.setAttribute("points", kept.map((number, at) => `${across(at)},${up(number)}`).join(" "));
  }

  function picture(link) {
    const made = document.createElementNS(NAMESPACE, "svg"), line = document.createElementNS(NAMESPACE, "polyline");
    const size = { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, "aria-hidden": "true" };
    for (const [name, value] of Object.entries(size)) made.setAttribute(name, value);
    made.append(line);
    link.querySelector(".line").replaceChildren(made);
    return line;
  }

  document.addEventListener("shown", look);
  look();
}
