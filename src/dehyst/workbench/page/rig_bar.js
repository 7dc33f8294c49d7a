// The bar that stays in sight while a rig is connected: what it does, and the stop.
import { byId, h, say, show } from "./dom.js";
import { percent, short } from "./numbers.js";
import { session, watch } from "./state.js";
import { bindStopKey, canMove, stop } from "./stop.js";

export const WORDS = {
  connecting: "connecting",
  connected: "connected, not armed",
  armed: "armed",
  playing: "playing",
  calibrating: "calibrating",
  stopping: "stopping",
  lost: "lost",
};
const parts = {};
let answer = ""; // to the stop, until the rig is armed again
let moved = false;

export function buildRigBar() {
  parts.button = h("button", { type: "button", class: "stop", onclick: press, "aria-keyshortcuts": "Escape" }, "STOP", h("small", {}, "Esc"));
  parts.name = h("b", {});
  parts.status = h("span", { class: "rig-status", role: "status" });
  parts.values = h("span", { class: "rig-values" });
  parts.progress = h("progress", { max: "1", "aria-label": "Progress of the rig", hidden: true });
  parts.answer = h("p", { class: "rig-answer", role: "alert" });
  byId("rig-bar").append(h("div", { class: "rig-words" }, parts.name, parts.status, parts.values, parts.progress), parts.answer, parts.button);
  bindStopKey(press);
  watch("state", refresh);
  watch("live", (live) => values(live.v?.at(-1), live.y?.at(-1)));
  watch("connection", () => refresh(session.state));
}

async function press() {
  parts.button.classList.add("pressed");
  answer = await stop().catch((error) => error.message);
  say(parts.answer, answer);
  parts.button.classList.remove("pressed");
}

function refresh({ rig }) {
  show(byId("rig-bar"), rig.status !== "none");
  const moves = canMove(rig);
  if (moves && !moved) answer = "";
  moved = moves;
  say(parts.answer, (!moves && (rig.words ?? []).slice(-2).join(" ")) || answer);
  if (rig.status === "none") return;
  byId("rig-bar").dataset.status = rig.status;
  parts.name.title = rig.name ?? "";
  say(parts.name, [rig.name, rig.axis && `axis ${rig.axis}`].filter(Boolean).join(", ") || rig.address || "Rig");
  const silent = Number.isFinite(rig.silent) ? ` (the rig's process does not answer since ${rig.silent} s: switch the amplifier off by hand)` : "";
  const gone = session.connected ? silent : " (the server does not answer; STOP still works)";
  say(parts.status, `${WORDS[rig.status] ?? rig.status}${rig.step ? `: ${rig.step}` : ""}${gone}`);
  values(rig.voltage, rig.displacement_um);
  const share = rig.progress;
  show(parts.progress, typeof share === "number");
  if (typeof share === "number") {
    parts.progress.value = share;
    parts.progress.title = percent(100 * share);
  }
}

function values(voltage, displacement) {
  const shown = [
    Number.isFinite(voltage) && `${short(voltage, 4)} V`,
    Number.isFinite(displacement) && `${short(displacement, 4)} \u00b5m`,
  ].filter(Boolean);
  say(parts.values, shown.join(" \u00b7 "));
}
