// Gestures of pointer and keys, which move the view of a chart.
const LEAST_DRAG = 6;

export const KEYS =
  "Keys: arrows move, plus and minus zoom, 0 shows all. Pointer: drag a box to zoom; double-click shows all.";

const shifted = ([low, high], share) => [low + share * (high - low), high + share * (high - low)];
// A range that is `factor` times as wide, with the same middle.
const scaled = ([low, high], factor) => {
  const more = ((factor - 1) * (high - low)) / 2;
  return [low - more, high + more];
};

export function bindGestures(chart) {
  const { top } = chart;
  let from = null;
  const mark = (box) => {
    chart.box = box;
    chart.request(false);
  };
  top.onpointerdown = (event) => {
    if (!chart.area || event.button > 0) return;
    top.setPointerCapture(event.pointerId);
    from = chart.place(event);
  };
  top.onpointermove = (event) => {
    if (!chart.area) return;
    const at = chart.place(event);
    if (from) mark(Math.hypot(at.x - from.x, at.y - from.y) > LEAST_DRAG ? boxed(chart.area, from, at) : null);
    else chart.read(at);
  };
  top.onpointerup = top.onpointercancel = ({ type }) => {
    const { box } = chart;
    from = null;
    mark(null);
    if (!box || type === "pointercancel") return;
    chart.show({ x: [chart.vx(box.left), chart.vx(box.right)], y: [chart.vy(box.bottom), chart.vy(box.top)] });
  };
  top.onpointerleave = () => {
    chart.nearest = null;
    chart.readout("");
    chart.request(false);
  };
  top.ondblclick = (event) => chart.double(event) || chart.show(chart.home);
  top.onkeydown = (event) => {
    const view = event.ctrlKey || event.metaKey ? null : viewAfter(chart, event.key);
    if (!view) return;
    event.preventDefault();
    chart.show(view);
  };
}

// The box of a drag: a nearly horizontal drag marks the full height, a nearly vertical one the full width.
function boxed({ left, top, width, height }, from, to) {
  const ends = (name, low, size) =>
    [from[name], to[name]].map((end) => Math.min(Math.max(end, low), low + size)).sort((a, b) => a - b);
  const [xs, ys] = [ends("x", left, width), ends("y", top, height)];
  const level = ys[1] - ys[0] < 2 * LEAST_DRAG;
  const steep = xs[1] - xs[0] < 2 * LEAST_DRAG && !level;
  const [[west, east], [north, south]] = [steep ? [left, left + width] : xs, level ? [top, top + height] : ys];
  return { left: west, right: east, top: north, bottom: south };
}

// The view after a key; undefined for a key without effect.
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
  }[key];
}
