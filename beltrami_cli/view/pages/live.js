// The live view: sends what the controls say, and shows what comes back.
"use strict";
(async () => {
  const part = (name) => document.getElementById(name);
  const form = part("controls");
  const asked = async (name, request, more = {}) => {
    const answer = await fetch(name, { method: "POST", body: JSON.stringify(request), ...more });
    if (!answer.ok) throw new Error((await answer.json()).message);
    return answer;
  };

  const viewer = await Viewer.opened(async () => (await fetch("model.glb")).arrayBuffer());
  const start = Viewer.data("start");
  let wholes = 0, refused = "", none = "", isSending = false, isStale = false, current = new AbortController();

  function fill(values) {
    for (const [name, value] of Object.entries(values)) {
      const input = form.elements[name], auto = form.querySelector(`[data-auto=${name}]`);
      if (name === "slots") for (const box of form.querySelectorAll("[name=slots]")) box.checked = value.includes(box.value);
      else if (input) input.value = value;
      if (auto) auto.checked = false;
    }
    label();
  }

  // What was refused stays in sight while older work ends.
  const say = (text) => { part("state").textContent = refused || `${none}${text}`; };

  function label() {
    for (const range of form.querySelectorAll("input[type=range]"))
      part(`${range.name}-value`).textContent = range.value;
  }

  function values() {
    const found = {}, boxes = [...form.querySelectorAll("[name=slots]")];
    for (const choice of form.querySelectorAll("select")) found[choice.name] = choice.value;
    for (const text of form.querySelectorAll("input[type=text]")) found[text.name] = text.value.trim();
    for (const range of form.querySelectorAll("input[type=range]"))
      if (!form.querySelector(`[data-auto=${range.name}]`)?.checked) found[range.name] = Number(range.value);
    if (boxes.length) found.slots = boxes.filter((box) => box.checked).map((box) => box.value);
    else if (start.values.slots) found.slots = start.values.slots;
    return found;
  }

  // One request is on its way at a time; only the last of the waiting ones is sent. An accepted one ends the one before.
  async function send() {
    isStale = true;
    if (isSending) return;
    isSending = true;
    while (isStale) {
      isStale = false;
      try {
        const request = { values: values(), layer: viewer.number, focus: viewer.focus(), target: part("target").value };
        part("viewer").dataset.asked = performance.now();
        none = "";
        const next = new AbortController(), { body } = await asked("change", request, { signal: next.signal });
        current.abort();
        current = next;
        refused = "";
        follow(body.pipeThrough(new TextDecoderStream()).getReader(), next.signal);
      } catch (error) {
        if (error instanceof TypeError) end();
        else say(refused = error.message);
      }
    }
    isSending = false;
  }

  // An event is a line. An answer that ends, or fails, and was not broken off here is the end of the program.
  async function follow(reader, signal) {
    const next = () => reader.read().catch(() => ({ done: true }));
    let line = [];
    for (let { value, done } = await next(); !done; { value, done } = await next()) {
      const [last, ...others] = value.split("\n");
      line.push(last);
      for (const first of others) {
        const event = JSON.parse(line.join(""));
        line = [first];
        await shown[event.kind](event);
      }
    }
    if (!signal.aborted) end();
  }

  function end() {
    part("state").textContent = "The program has ended; what was saved is kept.";
    for (const control of document.querySelectorAll("#controls *, #save *")) control.disabled = true;
  }

  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("change", ({ target }) => { if (target.type === "text") send(); });
  form.addEventListener("input", ({ target }) => {
    if (target.type === "text") return; // half of a text may be wrong
    const auto = target.type === "range" && form.querySelector(`[data-auto=${target.name}]`);
    if (auto) auto.checked = false;
    label();
    send();
  });
  part("target").addEventListener("change", send);
  part("viewer").addEventListener("layer", send);

  part("copy").addEventListener("click", async () => {
    await navigator.clipboard.writeText(part("command").textContent);
    part("copy").textContent = "Copied";
    setTimeout(() => { part("copy").textContent = "Copy command"; }, 2000);
  });

  part("save").addEventListener("submit", async (event) => {
    event.preventDefault();
    const button = part("save").querySelector("button");
    button.disabled = true;
    part("saved").textContent = "Smoothing the whole, as the command does.";
    try {
      const request = { values: values(), target: part("target").value, overwrite: part("overwrite").checked };
      const { written, warnings } = await (await asked("save", request)).json();
      part("saved").textContent = [`Written: ${written.join(", ")}.`, ...warnings].join(" ");
    } catch (error) {
      part("saved").textContent = error.message;
    }
    button.disabled = false;
  });

  const shown = {
    accepted: ({ command }) => { part("command").textContent = command; },
    progress: ({ label: what, share }) => {
      say(`Smoothing the whole: ${what}.`);
      part("progress").value = share;
    },
    none: ({ reason }) => {
      none = `No preview: ${reason}. `;
      say("The whole follows.");
    },
    preview: async ({ updates, samples, stage, seconds }) => {
      await viewer.updating.apply(updates);
      part("viewer").dataset.previews = Number(part("viewer").dataset.previews || 0) + 1;
      part("viewer").dataset.latency = performance.now() - part("viewer").dataset.asked;
      say(`Preview of ${samples} samples in the middle${stage}, ${seconds.toFixed(2)} s; the whole follows.`);
    },
    whole: async ({ updates, used, chosen, notices, noise }) => {
      await viewer.updating.apply(updates);
      part("progress").value = 1;
      none = "";
      say("Done.");
      part("used").innerHTML = used; // escaped where it is made
      part("notices").replaceChildren(...notices.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
      for (const [name, value] of Object.entries(chosen)) {
        const range = form.elements[name];
        if (range && form.querySelector(`[data-auto=${name}]`)?.checked) range.value = value;
      }
      if (noise) form.elements.noise.placeholder = `estimated: ${noise}`;
      label();
      part("viewer").dataset.whole = ++wholes;
    },
    failed: ({ message }) => say(message),
  };
  fill(start.values);
  send();
})();
