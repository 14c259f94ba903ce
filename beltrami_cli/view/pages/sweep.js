// Sorts the results of a sweep, and opens each large beside the input.
"use strict";
{
  const part = (name) => document.getElementById(name);
  const views = [...part("views").children], trials = JSON.parse(part("trials").textContent);
  const kept = views.filter((view) => view.dataset.kept), results = views.filter((view) => !view.dataset.kept);
  const rows = [...document.querySelectorAll("main tr")].slice(1), body = rows[0].parentElement;
  const input = kept.find((view) => view.dataset.kept === "before"), label = (view) => view.querySelector("p").textContent;
  const smaller = new Set(["delta_e"]); // of which less is better
  let order = results.map((_, number) => number), shown = 0;

  part("sort").addEventListener("change", ({ target: { value: key } }) => {
    const worth = (number) => trials[number].figures[key] ?? (smaller.has(key) ? Infinity : -Infinity);
    order = results.map((_, number) => number);
    if (key) order.sort((one, other) => (smaller.has(key) ? worth(one) - worth(other) : worth(other) - worth(one)));
    part("views").append(...order.map((number) => results[number]));
    body.append(...order.map((number) => rows[number]));
  });

  function open(view) {
    shown = Math.max(0, order.indexOf(results.indexOf(view)));
    part("name").textContent = part("caption").textContent = label(view);
    part("input").src = input.querySelector("img").src;
    part("result").src = view.querySelector("img").src;
    part("result").alt = label(view);
    if (!part("large").open) part("large").showModal();
  }
  const step = (by) => open(results[order[(shown + by + order.length) % order.length]]);

  for (const view of views) view.querySelector("button").addEventListener("click", () => open(view));
  part("previous").addEventListener("click", () => step(-1));
  part("next").addEventListener("click", () => step(1));
  part("close").addEventListener("click", () => part("large").close());
  part("large").addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by) step(by);
  });
}
