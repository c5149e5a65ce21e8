/* Pictures that move while they are looked at.

A picture is there without this file, as it was when the page was loaded. With it the picture is followed by its motion
stream as long as it is in the window, the page is not hidden and not paused; then the stream ends, so that nothing is
drawn that nobody sees. */
"use strict";
{
  const AGAIN = 4000; // milliseconds before a stream that broke is asked for again

  const mark = document.querySelector(".liveness");
  const seen = new Map(); // each picture that may move, and whether it is in the window

  function update(image) {
    const moves = seen.get(image) && !document.hidden && mark?.dataset.state !== "paused";
    if (Boolean(image.dataset.moving) === Boolean(moves)) return;
    image.dataset.still ??= image.getAttribute("src");
    image.dataset.moving = moves ? "yes" : "";
    image.src = moves ? image.dataset.motion : `${image.dataset.still}&v=${Date.now()}`;
  }

  const all = () => [...seen.keys()].forEach(update);
  const observer = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      seen.set(target, isIntersecting);
      update(target);
    }
  });

  function follow() {
    for (const image of document.querySelectorAll("img[data-motion]")) {
      if (seen.has(image)) continue;
      seen.set(image, false);
      image.addEventListener("error", () => {
        if (!image.dataset.moving) return;
        setTimeout(() => {
          image.dataset.moving = "";
          update(image);
        }, AGAIN);
      });
      observer.observe(image);
    }
    for (const image of seen.keys()) if (!image.isConnected) seen.delete(image);
  }

  document.addEventListener("visibilitychange", all);
  if (mark) new MutationObserver(all).observe(mark, { attributes: true, attributeFilter: ["data-state"] });
  new MutationObserver(() => document.readyState === "complete" && follow())
    .observe(document.querySelector("main"), { childList: true, subtree: true });
  addEventListener("pagehide", () => {
    for (const image of seen.keys()) {
      seen.set(image, false);
      update(image);
    }
  });
  /* A page is loaded once its pictures are; one that moves may never be. */
  if (document.readyState === "complete") follow();
  else addEventListener("load", follow);
}
