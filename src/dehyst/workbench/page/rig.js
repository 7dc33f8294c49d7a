// The sixth step: connect, look at the plan, confirm the limits, arm, calibrate or play, watch.
import { DECLARED } from "./declared.js";
import { h, table } from "./dom.js";
import { Figure, MICROMETRES, SECONDS, VOLTS } from "./figure.js";
import { Form, card, facts, fold, list } from "./forms.js";
import { duration, length, limitsFrom, percent, range, short, whole } from "./numbers.js";
import { canMove, statusOf } from "./rig_bar.js";
import { button, problem, redraw, rig as request, watch } from "./server.js";
import { isOpen } from "./steps.js";

const [connecting, planning, arming] = ["connect", "plan", "arm"].map((id) => new Form(id, DECLARED.forms[id]));
const playing = new Form("play", DECLARED.forms.play, redraw);
const LIMITS = Object.keys(arming.fields);

const limits = (form) => ({ limits: limitsFrom(form.values.low, form.values.high), slew: form.value("slew") });
const act = (text, work, properties) => button(text, "rig", work, { class: "main", ...properties });

const journey = document.getElementById("rig-steps");

export function rigView({ rig, voltages }) {
  const here = !["none", "lost"].includes(rig.status);
  const connected = here && rig.status !== "connecting";
  const moving = ["playing", "calibrating", "stopping"].includes(rig.status);
  return [
    h("p.error", { role: "alert" }, rig.error),
    problem("rig"),
    h("div.split",
      h("div.side",
        !here && connectCard(),
        connected && connectedCard(rig),
        connected && planCard(rig),
        rig.status === "connected" && armCard(rig),
        rig.status === "armed" && voltages.length > 0 && playCard(voltages),
      ),
      h("div.stage.rig-stage", { "data-moving": String(moving) },
        !here && journey,
        h("div#rig-result", rig.result && resultBlock(rig.result)),
        h("div#rig-live", { hidden: live.count === 0 }, live.view()),
        h("div#rig-plan", rig.plan && planTable(rig.plan)),
        h("ul#rig-words.remarks", (rig.words ?? []).map((one) => h("li", one))),
      ),
    ),
  ];
}

function connectCard() {
  const { values } = connecting;
  const connect = () => request("connect", { address: values.address.trim(), ...limits(connecting) });
  return card("1. Connect", { id: "rig-connect", key: "connect" },
    connecting.field("address"),
    connecting.row(LIMITS, "fields three"),
    h("p.muted", "Nothing moves before you arm. No voltage leaves these limits."),
    act("Connect", connect),
  );
}

function connectedCard(rig) {
  const about = [
    ["Status", statusOf(rig)],
    ["Address", rig.address ?? ""],
    ["Limits", range(rig.limits, "V")],
    ["Largest slew rate", `${short(rig.slew)} V/s`],
    ["Safe voltage", `${short(rig.safe)} V`],
  ];
  return card("Connected", { id: "rig-connected", key: "connected" },
    facts(about),
    h("p.row",
      canMove(rig) && act("Disarm", () => request("disarm"), { class: "" }),
      act("Disconnect", () => request("disconnect"), { class: "" }),
    ),
  );
}

function planCard(rig) {
  let missing = "";
  if (rig.status === "connected") missing = "Calibrating needs an armed rig: look at the plan, then arm.";
  else if (rig.status === "armed" && !rig.plan) missing = "Look at the plan first.";
  const ready = rig.status === "armed" && rig.plan;
  const calibrate = act("Calibrate", () => request("calibrate", planning.collected()), ready ? {} : { disabled: true });
  return card("2. Plan a calibration", { id: "rig-calibration", key: "calibration" },
    planning.row(Object.keys(planning.fields), "fields three"),
    h("p.row", act("Show the plan", () => request("plan", planning.collected()), { class: "" }), calibrate),
    h("p.muted", missing),
  );
}

function armCard({ identity, limits: ends, slew, safe }) {
  const confirm = `Type the limits again to confirm them: ${range(ends, "V")}, at most ${short(slew)} V/s.`;
  const check = `Check the actuator and the amplifier first. Safe voltage: ${short(safe)} V.`;
  const arm = async () => {
    await request("arm", { identity, ...limits(arming) });
    for (const name of LIMITS) arming.values[name] = "";
  };
  return card("3. Arm", { class: "danger", id: "rig-arm", key: "arm" },
    h("p", `Rig: ${identity}. ${confirm} ${check}`),
    arming.row(LIMITS, "fields three"),
    act("Arm with these limits", arm, { class: "main armed" }),
  );
}

function playCard(voltages) {
  const words = ({ name, samples, seconds }) => `${name}: ${whole(samples)} samples, ${duration(seconds)}`;
  playing.offer("voltage", voltages.map((one) => [one.id, words(one)]));
  const { voltage } = playing.values;
  return card("4. Play a voltage", { id: "rig-play", key: "play" },
    playing.field("voltage"),
    act("Play", () => request("play", { voltage })),
  );
}

// What a calibration would play, which is shown before anything is armed; and what came of it.
function planTable({ steps, seconds: all }) {
  const text = { text: "What", class: "text" };
  const heads = ["Step", text, "Samples", "Time", "Lowest (V)", "Highest (V)", "Steepest (V/s)"];
  const rows = steps.map(({ step, what, samples, seconds, lowest_V, highest_V, steepest_V_per_s }) => [
    String(step),
    h("td.text", what ?? ""),
    samples === undefined ? "" : whole(samples),
    duration(seconds),
    ...[lowest_V, highest_V, steepest_V_per_s].map((one) => short(one)),
  ]);
  return [
    h("h3", "What a calibration plays"),
    table("Plan of the calibration", heads, rows),
    h("p.muted", `It takes about ${duration(all)} in all.`),
  ];
}

function resultBlock({ kind, good, samples, compensated, nominal, warnings, command }) {
  const gain = percent(nominal?.largest_percent);
  const { done, error, rest } = {
    calibrate: {
      done: "Calibrated",
      error: percent(compensated?.largest_percent),
      rest: `of the stroke is the largest error on the measured path; ${gain} by a straight gain`,
    },
    record: { done: `Recorded ${whole(samples ?? 0)} samples` },
  }[kind];
  return h("div", { class: `outcome ${good === false ? "amber" : "green"}`, role: "status" },
    h("strong", good === false ? `${done}, with care` : done),
    error && h("b", error, " ", h("small", rest)),
    list(warnings),
    command && fold("The same in a terminal", h("pre", command)),
  );
}

const ROOM = 30_000; // samples that are kept
const STRIP = 20; // seconds of the strips
const NAMES = ["t", "v", "y", "expected"];

// The last samples of a rig: strips over time, and the loop.
class LiveFigures {
  constructor() {
    this.loop = new Figure({ title: "Loop, live" });
    this.voltage = new Figure({ title: `Voltage, last ${STRIP} s` });
    this.displacement = new Figure({ title: `Displacement, last ${STRIP} s` });
    this.kept = Object.fromEntries(NAMES.map((name) => [name, new Float64Array(ROOM)]));
    this.count = 0;
  }

  view() {
    const strips = h("div", this.voltage.element, this.displacement.element);
    if (this.count > 0) this.draw();
    return h("div.live", this.loop.element, strips);
  }

  add(message) {
    const { t = [] } = message;
    if (this.count > 0 && t.length && t[0] < this.kept.t[this.count - 1]) this.count = 0;
    if (this.count + t.length > ROOM) {
      for (const values of Object.values(this.kept)) values.copyWithin(0, this.count - ROOM / 2, this.count);
      this.count = ROOM / 2;
    }
    for (const name of NAMES) this.kept[name].set(t.map((_, i) => message[name]?.[i] ?? NaN), this.count);
    this.count += t.length;
  }

  draw() {
    const [t, v, y, expected] = NAMES.map((name) => this.kept[name].subarray(0, this.count));
    const now = t[this.count - 1];
    const seconds = { ...SECONDS, range: [Math.max(t[0], now - STRIP), Math.max(now, t[0] + 1)] };
    const both = (x, rising) => [
      { name: "measured", colour: "measured", x, y, rising },
      ...(expected.some(Number.isFinite) ? [{ name: "expected", colour: "simulated", x, y: expected, rising }] : []),
    ];
    const voltage = [{ name: "voltage", colour: "measured", x: t, y: v, rising: true }];
    this.loop.set({ x: VOLTS, y: MICROMETRES, series: both(v, false) }, { keep: true });
    this.voltage.set({ x: seconds, y: VOLTS, series: voltage }, { keep: true });
    this.displacement.set({ x: seconds, y: MICROMETRES, series: both(t, true) }, { keep: true });
  }
}

const live = new LiveFigures();
watch("live", (message) => {
  const began = live.count === 0;
  live.add(message);
  if (!isOpen("rig")) return;
  live.draw();
  if (began) document.getElementById("rig-live").hidden = false;
});
