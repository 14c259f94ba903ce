// Starts the viewer of a report; three.js is packed, since it is most of a small page.
"use strict";
(async () => {
  const models = document.getElementById("models"), packed = document.getElementById("three");
  if (!models) return;
  const library = document.createElement("script");
  library.textContent = new TextDecoder().decode(await Unpacking.inflated(JSON.parse(packed.textContent)));
  document.head.append(library); // the policy of the page allows this text
  new Viewer(document.getElementById("viewer"), JSON.parse(models.textContent)).start();
})();
