/* Says how long ago times were, beside them. The robot's clock counts, which may be wrong by years.

What comes to a page while it is looked at is told within a second. Without this file times are absolute alone. */
"use strict";
{
  const AGES = [[86400, "d"], [3600, "h"], [60, "min"], [1, "s"]]; // seconds of a unit, the longest first
  const SIMULATED = Date.UTC(1980); // before it are clocks that began at zero: their times have no age by another one
  let ahead = null; // milliseconds by which the robot's clock is ahead of this one

  const times = () => document.querySelectorAll("main time[datetime]");

  async function compareClocks() {
    ahead = NaN; // until there is an answer
    try {
      const answer = await fetch(document.querySelector("link[rel=stylesheet]").href, { method: "HEAD", cache: "no-store" });
      ahead = Date.parse(answer.headers.get("date")) - Date.now();
    } catch {
      // not reachable: times stay as they are
    }
  }

  function age(milliseconds) {
    const seconds = Math.round(milliseconds / 1000);
    const [size, unit] = AGES.find(([each]) => seconds >= each) ?? [1, "s"];
    return seconds < 1 ? "now" : `${Math.floor(seconds / size)} ${unit} ago`;
  }

  async function tellAges() {
    const found = times();
    if (found.length && ahead === null) await compareClocks();
    if (ahead === null || Number.isNaN(ahead)) return;
    for (const each of found) {
      const now = Date.now() + ahead, then = Date.parse(each.getAttribute("datetime"));
      if (then < SIMULATED && now > SIMULATED) continue;
      const since = now - then;
      const words = since > -5000 ? age(since) : null; // times to come are not told of
      if (words !== null && each.getAttribute("data-ago") !== words) each.setAttribute("data-ago", words);
    }
  }

  tellAges();
  setInterval(tellAges, 1000);
}
