// Moving a chart's view by pointer and keys.
const LEAST_DRAG = 6;
const WHEEL = 0.0015;

export const KEYS =
  "Keys: arrows move, plus and minus zoom, 0 shows all. Pointer: drag a box to zoom, or click and turn the wheel; " +
  "drag with Shift or the middle button to move; double-click shows all.";

export function bindGestures(chart) {
  const { top } = chart;
  top.onpointerdown = (event) => begin(chart, event);
  top.onpointermove = (event) => move(chart, chart.place(event));
  top.onpointerup = () => end(chart);
  top.onpointercancel = () => cancel(chart);
  top.onpointerleave = () => leave(chart);
  top.ondblclick = (event) => chart.double(event) || chart.show(chart.home);
  top.onkeydown = (event) => key(chart, event);
  top.addEventListener("wheel", (event) => wheel(chart, event), { passive: false });
}

function begin(chart, event) {
  if (!chart.area || event.button > 1) return;
  chart.top.setPointerCapture(event.pointerId);
  const pans = event.button === 1 || event.shiftKey;
  if (pans) event.preventDefault();
  chart.drag = { pans, from: chart.place(event), view: chart.view };
}

function move(chart, at) {
  const { area, drag } = chart;
  if (!area) return;
  if (!drag) {
    chart.read(at);
    return;
  }
  chart.nearest = null;
  if (drag.pans) {
    const share = { x: (drag.from.x - at.x) / area.width, y: (at.y - drag.from.y) / area.height };
    chart.show({ x: shifted(drag.view.x, share.x), y: shifted(drag.view.y, share.y) });
    return;
  }
  const far = Math.hypot(at.x - drag.from.x, at.y - drag.from.y) > LEAST_DRAG;
  chart.box = far ? boxed(area, drag.from, at) : null;
  chart.request(false);
}

function end(chart) {
  const { box } = chart;
  cancel(chart);
  if (!box) return;
  chart.show({ x: [chart.vx(box.left), chart.vx(box.right)], y: [chart.vy(box.bottom), chart.vy(box.top)] });
}

function cancel(chart) {
  chart.drag = null;
  chart.box = null;
  chart.request(false);
}

function leave(chart) {
  if (chart.drag) return;
  chart.nearest = null;
  chart.readout("");
  chart.request(false);
}

// What a drag marks: all heights if it is nearly level, all of the abscissa if it is nearly upright.
function boxed({ left, top, width, height }, from, to) {
  const within = (value, low, size) => Math.min(Math.max(value, low), low + size);
  const xs = [from.x, to.x].map((x) => within(x, left, width)).sort((a, b) => a - b);
  const ys = [from.y, to.y].map((y) => within(y, top, height)).sort((a, b) => a - b);
  const level = ys[1] - ys[0] < 2 * LEAST_DRAG;
  const steep = xs[1] - xs[0] < 2 * LEAST_DRAG && !level;
  return {
    left: steep ? left : xs[0],
    right: steep ? left + width : xs[1],
    top: level ? top : ys[0],
    bottom: level ? top + height : ys[1],
  };
}

const shifted = ([low, high], share) => [low + share * (high - low), high + share * (high - low)];

// A range that is `factor` times as wide, about a value that keeps its place.
const scaled = ([low, high], factor, about = (low + high) / 2) => [
  about - factor * (about - low),
  about + factor * (high - about),
];

// Over a chart that nobody clicked at, the wheel moves the page.
function wheel(chart, event) {
  if (!chart.area || document.activeElement !== chart.top) return;
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
  if (event.ctrlKey || event.metaKey) return;
  const { x, y } = chart.view;
  const view = {
    "+": { x: scaled(x, 0.7), y: scaled(y, 0.7) },
    "=": { x: scaled(x, 0.7), y: scaled(y, 0.7) },
    "-": { x: scaled(x, 1 / 0.7), y: scaled(y, 1 / 0.7) },
    ArrowLeft: { x: shifted(x, -0.1), y },
    ArrowRight: { x: shifted(x, 0.1), y },
    ArrowUp: { x, y: shifted(y, 0.1) },
    ArrowDown: { x, y: shifted(y, -0.1) },
    0: chart.home,
    Home: chart.home,
  }[event.key];
  if (!view) return;
  event.preventDefault();
  chart.show(view);
}
