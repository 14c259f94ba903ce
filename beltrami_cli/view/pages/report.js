// Starts the viewer of a report.
"use strict";
{
  const models = document.getElementById("models");
  if (models) new Viewer(document.getElementById("viewer"), JSON.parse(models.textContent)).start();
}
