// Start of the page: its steps, files that are dropped anywhere, and what happens when it is left.
import { byId } from "./dom.js";
import { exportView } from "./exports.js";
import { modelView } from "./models.js";
import { pathView } from "./path_step.js";
import { isSending, recordsView, sendAll } from "./records.js";
import { rigView } from "./rig.js";
import { buildRigBar, canMove } from "./rig_bar.js";
import { connect, session, watch } from "./server.js";
import { buildSteps } from "./steps.js";
import { trustView } from "./trust.js";

watch("state", ({ folder }) => {
  byId("folder").textContent = folder ?? "\u2013";
  byId("connection").textContent = session.connected ? "Connected" : "The server does not answer; trying again";
  document.body.classList.toggle("offline", !session.connected);
  document.title = `${folder ? `${folder} \u00b7 ` : ""}dehyst workbench`;
});
buildRigBar();
buildSteps({
  records: recordsView,
  model: modelView,
  trust: trustView,
  path: pathView,
  export: exportView,
  rig: rigView,
});

let depth = 0; // of elements that a file was dragged into
const holdsFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
const cover = (change) => {
  depth = change === 0 ? 0 : Math.max(0, depth + change);
  byId("drop-cover").hidden = depth === 0;
};
window.addEventListener("dragenter", (event) => holdsFiles(event) && cover(1));
window.addEventListener("dragleave", (event) => holdsFiles(event) && cover(-1));
window.addEventListener("dragover", (event) => event.preventDefault());
window.addEventListener("drop", (event) => {
  event.preventDefault();
  cover(0);
  if (holdsFiles(event)) sendAll(event.dataTransfer.files);
});

const keeper = new Worker("/page/keepalive.js", { type: "module" });
// Leaving the page ends an upload and what a rig plays.
window.addEventListener("beforeunload", (event) => {
  const { rig, jobs } = session.state;
  if (!canMove(rig) && !isSending() && !jobs.some((one) => one.status === "running")) return;
  event.preventDefault();
  keeper.postMessage(true);
  setTimeout(() => keeper.postMessage(false));
});
connect();
