// Start of the page: builds its steps, then listens to the server.
import { byId, say } from "./dom.js";
import { buildExport } from "./exports.js";
import { buildModels } from "./models.js";
import { buildPath } from "./path.js";
import { buildRecords } from "./records.js";
import { buildRig } from "./rig.js";
import { buildRigBar } from "./rig_bar.js";
import { connect, session, watch } from "./state.js";
import { buildSteps } from "./steps.js";
import { buildTrust } from "./trust.js";
import { canMove } from "./stop.js";
import { bindDrops, isSending } from "./upload.js";

for (const build of [buildRecords, buildModels, buildTrust, buildPath, buildExport, buildRig, buildRigBar, buildSteps]) build();
bindDrops();
watch("connection", (connected) => {
  say(byId("connection"), connected ? "Connected" : "The server does not answer; trying again");
  document.body.classList.toggle("offline", !connected);
});
watch("state", (state) => {
  say(byId("folder"), state.folder ?? "\u2013");
  document.title = `${state.folder ? `${state.folder} \u00b7 ` : ""}dehyst workbench`;
});
const keeper = new Worker("/page/keepalive.js");
// Leaving the page ends an upload and what a rig plays.
window.addEventListener("beforeunload", (event) => {
  const { rig, jobs } = session.state;
  if (!canMove(rig) && !isSending() && !jobs.some((one) => one.status === "running")) return;
  event.preventDefault();
  keeper.postMessage(true);
  setTimeout(() => keeper.postMessage(false));
});
connect();
