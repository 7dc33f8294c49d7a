// The sixth step: connect, look at the plan, confirm the limits, arm, calibrate or play, watch.
import { post } from "./api.js";
import { action, byId, errorPlace, field, h, keyed, number, say, show } from "./dom.js";
import { fact } from "./records.js";
import { LiveFigures } from "./live.js";
import { duration, parsed, range, short, whole } from "./numbers.js";
import { planTable, resultBlock } from "./rig_plan.js";
import { WORDS } from "./rig_bar.js";
import { session, watch } from "./state.js";
import { onStep } from "./steps.js";
import { canMove } from "./stop.js";

let live = null;
let problem = null;
const connect = {};
const arm = {};
const plan = {};
const play = {};

export function buildRig() {
  live = new LiveFigures();
  problem = errorPlace();
  byId("rig").append(
    h("h2", { class: "unseen" }, "Rig"),
    h("p", { class: "error", role: "alert", id: "rig-error" }),
    problem,
    h("div", { class: "split" }, h("div", { class: "side" }, connectCard(), connectedCard(), planCard(), armCard(), playCard()), h("div", { class: "stage rig-stage", id: "rig-stage" }, steps(), h("div", { id: "rig-result" }), h("div", { id: "rig-live", hidden: true }, live.element), h("div", { id: "rig-plan" }), h("ul", { id: "rig-words", class: "remarks" }))),
  );
  watch("state", refresh);
  watch("live", (message) => {
    live.add(message);
    show(byId("rig-live"), live.count > 0);
  });
  onStep("rig", () => live.count && live.draw());
}

const STEPS = [
  ["Connect", "The controller is opened and asked for its range. Nothing moves. A stop appears above and stays in sight; Escape presses it from anywhere."],
  ["Look at the plan", "What a calibration would play: voltages, rates, time. Nothing is sent."],
  ["Arm", "You type the limits again. From then on a watchdog in a process of its own ramps to the safe voltage if this page, the server or the network is lost."],
  ["Calibrate or play", "You watch the loop as it is measured. Each sample is written to disk as it arrives."],
];
const steps = () => h("ol", { class: "journey", id: "rig-steps" }, STEPS.map(([title, text]) => h("li", {}, h("b", {}, title), text)));

const button = (text, work, properties = {}) => action(h("button", { type: "button", class: "main", ...properties }, text), problem, work);

function valueOf(input, label, least = -Infinity) {
  const value = parsed(input.value);
  if (value === null || !(value > least)) throw new Error(`${label}: got ${input.value || "nothing"}, need a number${least === 0 ? " above 0" : ""}.`);
  return value;
}

function limitsOf({ low, high }) {
  const limits = [valueOf(low, "Lowest voltage"), valueOf(high, "Highest voltage")];
  if (!(limits[0] < limits[1])) throw new Error("The lowest voltage is not below the highest one.");
  return limits;
}

function connectCard() {
  Object.assign(connect, {
    address: h("input", { type: "text", autocomplete: "off", spellcheck: "false", value: "sim://play", list: "rig-addresses" }),
    low: number({ value: "0" }),
    high: number({ value: "100" }),
    slew: number({ value: "1000" }),
  });
  const addresses = ["sim://play", "pi://192.168.0.10:50000", "epics://PREFIX"];
  const work = () => post("/api/rig/connect", { address: connect.address.value.trim(), limits: limitsOf(connect), slew: valueOf(connect.slew, "Largest slew rate", 0) });
  return h(
    "div",
    { class: "card", id: "rig-connect" },
    h("h3", {}, "1. Connect"),
    h("datalist", { id: "rig-addresses" }, addresses.map((value) => h("option", { value }))),
    field("Address", connect.address, { hint: "sim://play (simulated), pi://HOST:PORT, epics://PREFIX or ni://DEVICE" }),
    h("div", { class: "fields three" }, field("Lowest", connect.low, { unit: "V" }), field("Highest", connect.high, { unit: "V" }), field("Slew rate", connect.slew, { unit: "V/s" })),
    h("p", { class: "muted" }, "Nothing moves before you arm. No voltage leaves these limits."),
    button("Connect", work),
  );
}

function connectedCard() {
  return h(
    "div",
    { class: "card", id: "rig-connected", hidden: true },
    h("h3", {}, "Connected"),
    h("dl", { class: "facts", id: "rig-facts" }),
    h("p", { class: "row" }, button("Disarm", () => post("/api/rig/disarm"), { id: "rig-disarm", class: "" }), button("Disconnect", () => post("/api/rig/disconnect"), { class: "" })),
  );
}

// What is missing before a calibration can begin.
const NEEDS = {
  connected: () => "Calibrating needs an armed rig: look at the plan, then arm.",
  armed: (rig) => (rig.plan ? "" : "Look at the plan first."),
};

const calibration = () => ({ frequency: valueOf(plan.frequency, "Loops a second", 0), rounds: valueOf(plan.rounds, "Rounds", -1), goal: valueOf(plan.goal, "Goal", 0) });

function planCard() {
  Object.assign(plan, { frequency: number({ value: "1" }), rounds: number({ value: "2" }), goal: number({ value: "1" }) });
  return h(
    "div",
    { class: "card", id: "rig-calibration", hidden: true },
    h("h3", {}, "2. Plan a calibration"),
    h("div", { class: "fields three" }, field("Loops a second", plan.frequency, { unit: "Hz" }), field("Further rounds", plan.rounds), field("Goal", plan.goal, { unit: "%" })),
    h("p", { class: "row" }, button("Show the plan", () => post("/api/rig/plan", calibration())), button("Calibrate", () => post("/api/rig/calibrate", calibration()), { id: "rig-calibrate" })),
    h("p", { class: "muted", id: "rig-calibrate-words" }),
  );
}

// Arming repeats the limits: the person types them again. The rig's process compares, and that it is the rig shown here.
function armCard() {
  Object.assign(arm, { low: number({ id: "arm-low" }), high: number({ id: "arm-high" }), slew: number({ id: "arm-slew" }) });
  const work = async () => {
    await post("/api/rig/arm", { identity: session.state.rig.identity, limits: limitsOf(arm), slew: valueOf(arm.slew, "Largest slew rate", 0) });
    for (const input of Object.values(arm)) input.value = "";
  };
  return h(
    "div",
    { class: "card danger", id: "rig-arm", hidden: true },
    h("h3", {}, "3. Arm"),
    h("p", { id: "rig-arm-words" }),
    h("div", { class: "fields three" }, field("Lowest", arm.low, { unit: "V" }), field("Highest", arm.high, { unit: "V" }), field("Slew rate", arm.slew, { unit: "V/s" })),
    button("Arm with these limits", work, { class: "main armed" }),
  );
}

function playCard() {
  play.select = h("select", {});
  return h(
    "div",
    { class: "card", id: "rig-play", hidden: true },
    h("h3", {}, "4. Play a voltage"),
    field("Voltage", play.select),
    button("Play", () => post("/api/rig/play", { voltage: play.select.value })),
  );
}

function refresh(state) {
  const { rig } = state;
  const here = !["none", "lost"].includes(rig.status);
  say(byId("rig-error"), rig.error ?? "");
  show(byId("rig-connect"), !here);
  show(byId("rig-steps"), !here);
  for (const id of ["rig-connected", "rig-calibration"]) show(byId(id), here && rig.status !== "connecting");
  show(byId("rig-arm"), rig.status === "connected");
  show(byId("rig-play"), rig.status === "armed" && state.voltages.length > 0);
  show(byId("rig-disarm"), canMove(rig));
  show(byId("rig-live"), live.count > 0);
  byId("rig-stage").dataset.moving = String(["playing", "calibrating", "stopping"].includes(rig.status));
  byId("rig-calibrate").disabled = rig.status !== "armed" || !rig.plan;
  say(byId("rig-calibrate-words"), NEEDS[rig.status]?.(rig) ?? "");
  say(byId("rig-arm-words"), `Rig: ${rig.identity}. Type the limits again to confirm them: ${range(rig.limits, "V")}, at most ${short(rig.slew)} V/s. Check the actuator and the amplifier first. Safe voltage: ${short(rig.safe)} V.`);
  keyed(byId("rig-facts"), facts(rig), { key: ([name]) => name, create: ([name, value]) => h("div", {}, fact(name, value)) });
  keyed(byId("rig-plan"), rig.plan ? [{ id: "plan", plan: rig.plan }] : [], { create: (one) => h("div", {}, planTable(one.plan)) });
  keyed(byId("rig-result"), rig.result ? [{ id: "result", result: rig.result }] : [], { create: (one) => h("div", {}, resultBlock(one.result)) });
  keyed(byId("rig-words"), (rig.words ?? []).map((text, k) => ({ id: k, text })), { create: (one) => h("li", {}, one.text) });
  keyed(play.select, state.voltages.map(({ id, name, seconds, samples }) => ({ id, name, seconds, samples })), { create: (one) => h("option", { value: one.id }, `${one.name}: ${whole(one.samples)} samples, ${duration(one.seconds)}`) });
}

function facts(rig) {
  return [
    ["Status", WORDS[rig.status] ?? rig.status],
    ["Address", rig.address ?? ""],
    ["Limits", range(rig.limits, "V")],
    ["Largest slew rate", `${short(rig.slew)} V/s`],
    ["Safe voltage", `${short(rig.safe)} V`],
  ];
}
