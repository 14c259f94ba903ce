// Starts the viewer of a report.
"use strict";
Viewer.opened(() => Unpacking.restored(Viewer.data("models")));
