// The stop: at the listener of the process that holds the rig and at the server, both at once. Either is enough. Both
// answer when that process confirms the stop.
import { announce } from "./dom.js";
import { session } from "./state.js";

const MOVING = new Set(["armed", "playing", "calibrating", "stopping"]);
// Milliseconds after which no answer will come.
const PATIENCE = 4000;
export const canMove = (rig) => MOVING.has(rig.status);

// Resolve with a sentence on what was confirmed; reject if nothing was.
export async function stop() {
  const ways = [
    fetch("/api/rig/stop", { method: "POST", headers: { "Content-Type": "application/json" }, body: "{}", signal: AbortSignal.timeout(PATIENCE) }).then((answer) => confirmed(answer, "the server")),
  ];
  const emergency = session.state.rig.stop;
  if (emergency) {
    const request = { method: "POST", headers: { "X-Dehyst-Stop": emergency.key }, keepalive: true, signal: AbortSignal.timeout(PATIENCE) };
    ways.unshift(fetch(`http://127.0.0.1:${emergency.port}/stop`, request).then((answer) => confirmed(answer, "the rig's own process")));
  }
  announce("Stop requested.");
  try {
    return await Promise.any(ways);
  } catch {
    throw new Error("NOBODY CONFIRMED THE STOP. Switch the amplifier off by hand. The rig's watchdog ramps to the safe voltage when it hears nothing.");
  }
}

function confirmed(answer, who) {
  if (answer.status === 409) return "Nothing was armed, and the voltage was not moved.";
  if (!answer.ok) throw new Error(`${who}: ${answer.status}`);
  return `Stop received by ${who} and confirmed; the voltage ramps to its safe value.`;
}

// Escape stops from anywhere on the page while the rig can move.
export function bindStopKey(pressed) {
  window.addEventListener(
    "keydown",
    (event) => {
      if (event.key !== "Escape" || event.repeat || !canMove(session.state.rig)) return;
      event.preventDefault();
      event.stopPropagation();
      pressed();
    },
    { capture: true },
  );
}
