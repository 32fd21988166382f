"use strict";
// Progress of the studies at work is asked for again and again; the page itself is loaded anew where
// a study begins or ends. Without scripts the page shows the state of the moment it was loaded.
const EVERY = 2000;
const bars = () => [...document.querySelectorAll("progress[data-study]")];
const update = (running) => {
  const names = bars().map((bar) => bar.dataset.study);
  const now = Object.keys(running);
  if (now.length !== names.length || names.some((name) => !(name in running))) {
    location.reload();
    return;
  }
  bars().forEach((bar) => {
    const { done, total, said } = running[bar.dataset.study];
    bar.max = total || 1;
    bar.value = done;
    bar.nextElementSibling.textContent = said;
  });
};
const ask = async () => {
  try {
    const answer = await fetch("/progress.json", { cache: "no-store" });
    if (answer.ok) update(await answer.json());
  } catch {
    document.querySelector("#lost").hidden = false;
    return;
  }
  setTimeout(ask, EVERY);
};
setTimeout(ask, EVERY);
