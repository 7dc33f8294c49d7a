// Starts the page: shows its steps, and accepts files that are dropped anywhere on it.
import { byId } from "./dom.js";
import { exportView } from "./exports.js";
import { modelView } from "./models.js";
import { pathView } from "./path_step.js";
import { recordsView, sendAll } from "./records.js";
import { connect, session, watch } from "./server.js";
import { buildSteps } from "./steps.js";

watch(({ folder }) => {
  byId("folder").textContent = folder ?? "\u2013";
  byId("connection").textContent = session.connected ? "Connected" : "The server does not answer; trying again";
  document.body.classList.toggle("offline", !session.connected);
  document.title = `${folder ? `${folder} \u00b7 ` : ""}dehyst workbench`;
});
buildSteps({ records: recordsView, model: modelView, path: pathView, export: exportView });

window.addEventListener("dragover", (event) => event.preventDefault());
window.addEventListener("drop", (event) => {
  event.preventDefault();
  if (event.dataTransfer?.files.length) sendAll(event.dataTransfer.files);
});

connect();
