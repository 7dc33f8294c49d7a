// The stop: at the listener of the process that holds the rig and at the server, both at once. Either is enough.
import { announce } from "./dom.js";
import { session } from "./state.js";

const MOVING = new Set(["armed", "playing", "calibrating", "stopping"]);
export const canMove = (rig) => MOVING.has(rig.status);

// Resolve with words about who received it; reject if nobody did.
export async function stop() {
  const ways = [
    fetch("/api/rig/stop", { method: "POST", headers: { "Content-Type": "application/json" }, body: "{}" }).then((answer) => received(answer, "the server")),
  ];
  const emergency = session.state.rig.stop;
  if (emergency) {
    const request = { method: "POST", headers: { "X-Dehyst-Stop": emergency.key }, keepalive: true };
    ways.unshift(fetch(`http://127.0.0.1:${emergency.port}/stop`, request).then((answer) => received(answer, "the rig's own process")));
  }
  announce("Stop requested.");
  try {
    return `Stop received by ${await Promise.any(ways)}; the voltage ramps to its safe value.`;
  } catch {
    throw new Error("NOBODY RECEIVED THE STOP. Switch the amplifier off by hand. The rig's watchdog ramps to the safe voltage when it hears nothing.");
  }
}

function received(answer, who) {
  if (!answer.ok) throw new Error(`${who}: ${answer.status}`);
  return who;
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
