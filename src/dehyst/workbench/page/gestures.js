// Moving a chart's view by pointer and keys. A chart's `editor`, if it has one, is asked first.
const LEAST_DRAG = 6;
const WHEEL = 0.0015;

export function bindGestures(chart) {
  const { top } = chart;
  top.addEventListener("pointerdown", (event) => begin(chart, event));
  top.addEventListener("pointermove", (event) => move(chart, event));
  top.addEventListener("pointerup", (event) => end(chart, event));
  top.addEventListener("pointercancel", () => cancel(chart));
  top.addEventListener("pointerleave", () => leave(chart));
  top.addEventListener("dblclick", (event) => chart.editor?.double?.(event) || chart.show(chart.home));
  top.addEventListener("keydown", (event) => key(chart, event));
  top.addEventListener("wheel", (event) => wheel(chart, event), { passive: false });
}

function begin(chart, event) {
  if (!chart.area) return;
  chart.top.setPointerCapture(event.pointerId);
  if (event.button === 0 && !event.shiftKey && chart.editor?.begin(event)) return;
  if (event.button > 1) return;
  const pans = event.button === 1 || event.shiftKey;
  if (pans) event.preventDefault();
  chart.drag = { pans, from: chart.place(event), view: chart.view };
}

function move(chart, event) {
  if (!chart.area || chart.editor?.move(event)) return;
  const at = chart.place(event);
  const { drag } = chart;
  if (!drag) {
    chart.read(at);
    return;
  }
  chart.nearest = null;
  if (drag.pans) {
    const share = { x: (drag.from.x - at.x) / chart.area.width, y: (at.y - drag.from.y) / chart.area.height };
    chart.show({ x: shifted(drag.view.x, share.x), y: shifted(drag.view.y, share.y) });
    return;
  }
  const far = Math.hypot(at.x - drag.from.x, at.y - drag.from.y) > LEAST_DRAG;
  chart.box = far ? boxed(chart, drag.from, at) : null;
  chart.requestTop();
}

function end(chart, event) {
  if (chart.editor?.end(event)) return;
  const { box } = chart;
  cancel(chart);
  if (!box) return;
  chart.show({
    x: [chart.vx(box.left), chart.vx(box.right)],
    y: [chart.vy(box.bottom), chart.vy(box.top)],
  });
}

function cancel(chart) {
  chart.drag = null;
  chart.box = null;
  chart.requestTop();
}

function leave(chart) {
  if (chart.drag) return;
  chart.nearest = null;
  chart.readout("");
  chart.requestTop();
}

// What a drag marks: all heights if it is nearly level, all of the abscissa if it is nearly upright.
function boxed(chart, from, to) {
  const { left, top, width, height } = chart.area;
  const within = (value, low, size) => Math.min(Math.max(value, low), low + size);
  const xs = [from.x, to.x].map((x) => within(x, left, width)).sort((a, b) => a - b);
  const ys = [from.y, to.y].map((y) => within(y, top, height)).sort((a, b) => a - b);
  const level = ys[1] - ys[0] < 2 * LEAST_DRAG;
  const steep = xs[1] - xs[0] < 2 * LEAST_DRAG;
  return {
    left: steep && !level ? left : xs[0],
    right: steep && !level ? left + width : xs[1],
    top: level ? top : ys[0],
    bottom: level ? top + height : ys[1],
  };
}

export const shifted = ([low, high], share) => [low + share * (high - low), high + share * (high - low)];

// A range that is `factor` times as wide, about a value that keeps its place.
export const scaled = ([low, high], factor, about = (low + high) / 2) => [
  about - factor * (about - low),
  about + factor * (high - about),
];

function wheel(chart, event) {
  if (!chart.area) return;
  event.preventDefault();
  const lines = event.deltaMode === 1 ? 20 : 1;
  const factor = Math.exp(Math.max(-1, Math.min(1, WHEEL * lines * event.deltaY)));
  const at = chart.place(event);
  const { view } = chart;
  chart.show({
    x: event.altKey ? view.x : scaled(view.x, factor, chart.vx(at.x)),
    y: event.shiftKey ? view.y : scaled(view.y, factor, chart.vy(at.y)),
  });
}

function key(chart, event) {
  if (event.ctrlKey || event.metaKey || chart.editor?.key(event)) return;
  const { x, y } = chart.view;
  const views = {
    "+": { x: scaled(x, 0.7), y: scaled(y, 0.7) },
    "=": { x: scaled(x, 0.7), y: scaled(y, 0.7) },
    "-": { x: scaled(x, 1 / 0.7), y: scaled(y, 1 / 0.7) },
    ArrowLeft: { x: shifted(x, -0.1), y },
    ArrowRight: { x: shifted(x, 0.1), y },
    ArrowUp: { x, y: shifted(y, 0.1) },
    ArrowDown: { x, y: shifted(y, -0.1) },
    0: chart.home,
    Home: chart.home,
  };
  if (!(event.key in views)) return;
  event.preventDefault();
  chart.show(views[event.key]);
}
