// Sorts the results of a sweep, opens each large next to the input, and loads more while there are more to come.
"use strict";
{
  const part = (name) => document.getElementById(name);
  const views = [...part("views").children], trials = JSON.parse(part("trials").textContent);
  const kept = views.filter((view) => view.dataset.kept), missing = views.filter((view) => view.matches(".missing"));
  const results = views.filter((view) => !view.dataset.kept && !missing.includes(view));
  const drawn = [...kept, ...results];
  const rows = [...document.querySelectorAll("main tr")].slice(1), body = rows[0].parentElement;
  const input = kept.find((view) => view.dataset.kept === "before"), label = (view) => view.querySelector("p").textContent;
  const smaller = new Set(["delta_e"]); // figures that are better if they are smaller
  let order = results.map((_, number) => number), shown = 0;

  function sort() {
    const key = part("sort").value;
    const worth = (number) => trials[number].figures[key] ?? (smaller.has(key) ? Infinity : -Infinity);
    order = results.map((_, number) => number);
    if (key) order.sort((one, other) => (smaller.has(key) ? worth(one) - worth(other) : worth(other) - worth(one)));
    part("views").append(...order.map((number) => results[number]), ...missing);
    body.append(...order.map((number) => rows[number]));
  }

  function open(view) {
    shown = Math.max(0, order.indexOf(results.indexOf(view)));
    part("name").textContent = part("caption").textContent = label(view);
    part("input").src = input.querySelector("img").src;
    part("result").src = view.querySelector("img").src;
    part("result").alt = label(view);
    if (!part("large").open) part("large").showModal();
  }
  const step = (by) => open(results[order[(shown + by + order.length) % order.length]]);

  for (const view of drawn) view.querySelector("button").addEventListener("click", () => open(view));
  part("previous").addEventListener("click", () => step(-1));
  part("next").addEventListener("click", () => step(1));
  part("close").addEventListener("click", () => part("large").close());
  part("large").addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by) step(by);
  });
  part("sort").addEventListener("change", sort);

  // A reload keeps the settings and the focus, in the entry of the history.
  const focusable = [part("sort"), part("follow"), ...drawn.map((view) => view.querySelector("button"))];
  const { key, follows, focus } = history.state ?? { key: "", follows: true, focus: -1 };
  part("follow").checked = follows;
  part("sort").value = key;
  if (key) sort();
  focusable[focus]?.focus({ preventScroll: true });
  if (document.querySelector("main").dataset.state === "pending") {
    part("following").hidden = false;
    setInterval(() => {
      if (!part("follow").checked || part("large").open) return;
      const now = { key: part("sort").value, follows: true, focus: focusable.indexOf(document.activeElement) };
      history.replaceState(now, "");
      location.reload();
    }, Math.max(2000, 5 * performance.now())); // milliseconds; large pages take long to load
  }
}
