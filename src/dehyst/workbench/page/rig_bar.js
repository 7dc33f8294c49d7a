// The bar that stays in sight while a rig is connected: what it does, and the stop. The stop goes to the listener of
// the process that holds the rig and to the server, both at once. Either is enough. Both answer when that process
// confirms it.
import { byId, fill, h } from "./dom.js";
import { percent, short } from "./numbers.js";
import { announce, session, stopRequests, watch } from "./server.js";

export const statusOf = ({ status }) => (status === "connected" ? "connected, not armed" : status);
const MOVING = new Set(["armed", "playing", "calibrating", "stopping"]);
export const canMove = (rig) => MOVING.has(rig.status);

const STOP = { type: "button", onclick: press, "aria-keyshortcuts": "Escape" };
// Milliseconds after which no answer will come.
const PATIENCE = 4000;
const last = { values: [], answer: "", moved: false, pressed: false }; // the answer counts until the rig is armed again

export function buildRigBar() {
  window.addEventListener("keydown", byKey, { capture: true });
  watch("state", ({ rig }) => {
    last.values = [rig.voltage, rig.displacement_um];
    if (canMove(rig) && !last.moved) last.answer = "";
    last.moved = canMove(rig);
    draw();
  });
  watch("live", ({ v, y }) => {
    last.values = [v?.at(-1), y?.at(-1)];
    draw();
  });
}

// Escape stops from anywhere on the page while the rig can move.
function byKey(event) {
  if (event.key !== "Escape" || event.repeat || !canMove(session.state.rig)) return;
  event.preventDefault();
  event.stopPropagation();
  press();
}

async function press() {
  last.pressed = true;
  draw();
  last.answer = await stop().catch((error) => error.message);
  last.pressed = false;
  draw();
}

// Resolve with a sentence on what was confirmed; reject if nothing was.
async function stop() {
  const ways = stopRequests(session.state.rig.stop, PATIENCE);
  announce("Stop requested.");
  try {
    return await Promise.any(ways.map(async ([who, answer]) => confirmed(await answer, who)));
  } catch {
    throw new Error(
      "NOBODY CONFIRMED THE STOP. Switch the amplifier off by hand. The rig's watchdog ramps to the safe voltage " +
        "when it hears nothing.",
    );
  }
}

function confirmed(answer, who) {
  if (answer.status === 409) return "Nothing was armed, and the voltage was not moved.";
  if (!answer.ok) throw new Error(`${who}: ${answer.status}`);
  return `Stop received by ${who} and confirmed; the voltage ramps to its safe value.`;
}

function draw() {
  const { rig } = session.state;
  const bar = byId("rig-bar");
  bar.hidden = rig.status === "none";
  bar.dataset.status = rig.status;
  fill(bar, rig.status === "none" ? [] : contents(rig));
}

function contents(rig) {
  const { name, axis, address, step, silent, progress, words = [] } = rig;
  const title = [name, axis && `axis ${axis}`].filter(Boolean).join(", ") || address || "Rig";
  let gone = "";
  if (!session.connected) gone = " (the server does not answer; STOP still works)";
  else if (Number.isFinite(silent)) {
    gone = ` (the rig's process does not answer since ${silent} s: switch the amplifier off by hand)`;
  }
  const units = ["V", "\u00b5m"];
  const values = last.values.map((one, k) => Number.isFinite(one) && `${short(one, 4)} ${units[k]}`).filter(Boolean);
  const answer = (!last.moved && words.slice(-2).join(" ")) || last.answer;
  const known = typeof progress === "number";
  const share = { value: known ? progress : 0, title: known && percent(100 * progress), hidden: !known };
  return [
    h("div.rig-words",
      h("b", { title: name }, title),
      h("span.rig-status", { role: "status" }, `${[statusOf(rig), step].filter(Boolean).join(": ")}${gone}`),
      h("span.rig-values", values.join(" \u00b7 ")),
      h("progress", { max: "1", "aria-label": "Progress of the rig", ...share }),
    ),
    h("p.rig-answer", { role: "alert" }, answer),
    h("button", { ...STOP, class: last.pressed ? "stop pressed" : "stop" }, "STOP", h("small", "Esc")),
  ];
}
