// Moving a chart's view by pointer and keys.
const LEAST_DRAG = 6;
const WHEEL = 0.0015;

export const KEYS =
  "Keys: arrows move, plus and minus zoom, 0 shows all. Pointer: drag a box to zoom, or click and turn the wheel; " +
  "drag with Shift or the middle button to move; double-click shows all.";

const shifted = ([low, high], share) => [low + share * (high - low), high + share * (high - low)];
// A range that is `factor` times as wide, about a value that keeps its place.
const scaled = ([low, high], factor, about = (low + high) / 2) => [
  about - factor * (about - low),
  about + factor * (high - about),
];

export function bindGestures(chart) {
  const { top } = chart;
  let drag = null;
  const mark = (box) => {
    chart.box = box;
    chart.request(false);
  };
  const leave = () => {
    chart.nearest = null;
    chart.readout("");
    chart.request(false);
  };
  top.onpointerdown = (event) => {
    if (!chart.area || event.button > 1) return;
    top.setPointerCapture(event.pointerId);
    const pans = event.button === 1 || event.shiftKey;
    if (pans) event.preventDefault();
    drag = { pans, from: chart.place(event), view: chart.view };
  };
  top.onpointermove = (event) => {
    if (!chart.area) return;
    const at = chart.place(event);
    if (!drag) {
      chart.read(at);
      return;
    }
    const { from, view, pans } = drag;
    const { width, height } = chart.area;
    chart.nearest = null;
    if (pans) chart.show({ x: shifted(view.x, (from.x - at.x) / width), y: shifted(view.y, (at.y - from.y) / height) });
    else mark(Math.hypot(at.x - from.x, at.y - from.y) > LEAST_DRAG ? boxed(chart.area, from, at) : null);
  };
  top.onpointerup = top.onpointercancel = ({ type }) => {
    const { box } = chart;
    drag = null;
    mark(null);
    if (!box || type === "pointercancel") return;
    chart.show({ x: [chart.vx(box.left), chart.vx(box.right)], y: [chart.vy(box.bottom), chart.vy(box.top)] });
  };
  top.onpointerleave = () => drag || leave();
  top.ondblclick = (event) => chart.double(event) || chart.show(chart.home);
  top.onkeydown = (event) => {
    const view = event.ctrlKey || event.metaKey ? null : viewAfter(chart, event.key);
    if (!view) return;
    event.preventDefault();
    chart.show(view);
  };
  // Over a chart that nobody clicked at, the wheel moves the page.
  const turned = (event) => {
    if (!chart.area || document.activeElement !== top) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 20 : 1;
    const factor = Math.exp(Math.max(-1, Math.min(1, WHEEL * lines * event.deltaY)));
    const { view } = chart;
    const at = chart.place(event);
    chart.show({
      x: event.altKey ? view.x : scaled(view.x, factor, chart.vx(at.x)),
      y: event.shiftKey ? view.y : scaled(view.y, factor, chart.vy(at.y)),
    });
  };
  top.addEventListener("wheel", turned, { passive: false });
}

// The box that a drag marks: all heights if it is nearly level, all of the abscissa if it is nearly upright.
function boxed({ left, top, width, height }, from, to) {
  const ends = (name, low, size) =>
    [from[name], to[name]].map((one) => Math.min(Math.max(one, low), low + size)).sort((a, b) => a - b);
  const [xs, ys] = [ends("x", left, width), ends("y", top, height)];
  const level = ys[1] - ys[0] < 2 * LEAST_DRAG;
  const steep = xs[1] - xs[0] < 2 * LEAST_DRAG && !level;
  const [[west, east], [north, south]] = [steep ? [left, left + width] : xs, level ? [top, top + height] : ys];
  return { left: west, right: east, top: north, bottom: south };
}

// The view after a key; undefined if it moves nothing.
function viewAfter({ view: { x, y }, home }, key) {
  const zoomed = (factor) => ({ x: scaled(x, factor), y: scaled(y, factor) });
  return {
    "+": zoomed(0.7),
    "=": zoomed(0.7),
    "-": zoomed(1 / 0.7),
    ArrowLeft: { x: shifted(x, -0.1), y },
    ArrowRight: { x: shifted(x, 0.1), y },
    ArrowUp: { x, y: shifted(y, 0.1) },
    ArrowDown: { x, y: shifted(y, -0.1) },
    0: home,
    Home: home,
  }[key];
}
