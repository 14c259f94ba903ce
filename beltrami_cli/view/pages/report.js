// Starts the viewer of a report; three.js is packed, since it is most of a small page.
"use strict";
(async () => {
  const packed = (name) => JSON.parse(document.getElementById(name).textContent);
  const library = document.createElement("script");
  library.textContent = new TextDecoder().decode(await Unpacking.inflated(packed("three")));
  document.head.append(library); // the policy of the page allows this text
  new Viewer(document.getElementById("viewer"), await Unpacking.restored(packed("models"))).start();
})();
