// Elements of a page from descriptions. A new description changes the elements in place: focus, scrolling, typed text
// and open folds stay.

export const byId = (id) => document.getElementById(id);

// h("button#go.main", { onclick: f }, "Identify") describes <button id="go" class="main">; properties may be left out.
// A child is a description, text or an existing element; null and false give nothing. Children whose number changes
// have a `key`.
export function h(name, ...children) {
  const [, tag, id, classes] = /^(\w+)(?:#([\w-]+))?(?:\.([\w.-]+))?$/.exec(name);
  const given = children[0]?.constructor === Object && !children[0].tag ? children.shift() : {};
  const style = [classes?.replaceAll(".", " "), given.class].filter(Boolean).join(" ");
  return { tag, properties: { id, ...given, class: style || undefined }, children: children.flat(9) };
}

export function make(given) {
  if (given instanceof Node) {
    given.held = true;
    return given;
  }
  if (given?.tag) return changed(document.createElement(given.tag), given);
  return document.createTextNode(textOf(given));
}

const textOf = (child) => (child === null || child === undefined || child === false ? "" : String(child));

// Replace the children of an element by the described ones. A child with the same key is changed in place; for a
// description without a key, this is the next child without a key.
export function fill(parent, ...described) {
  const children = described.flat(9);
  const old = [...parent.childNodes].filter((node) => !children.includes(node));
  const keyed = new Map(old.map((node) => [node.given?.key, node]));
  const others = old.filter((node) => node.given?.key === undefined);
  const nodes = children.map((child) => {
    if (child instanceof Node) return make(child);
    const key = child?.properties?.key;
    const node = key === undefined ? others.shift() : keyed.get(key);
    return fits(node, child) ? changed(node, child) : make(child);
  });
  // Remove first, then insert: nodes that stay do not move, and keep the focus.
  const kept = new Set(nodes);
  for (const node of [...parent.childNodes]) if (!kept.has(node)) node.remove();
  nodes.forEach((node, k) => {
    if (parent.childNodes[k] !== node) parent.insertBefore(node, parent.childNodes[k] ?? null);
  });
}

// Can a node be changed into the described one? An element that was passed in by its owner cannot.
function fits(node, child) {
  if (!node || node.held || child instanceof Node) return false;
  if (!child?.tag) return node.nodeType === Node.TEXT_NODE;
  return node.localName === child.tag && node.given?.key === child.properties.key;
}

function changed(node, child) {
  if (!child?.tag) {
    if (node.data !== textOf(child)) node.data = textOf(child);
    return node;
  }
  const [before, after] = [node.given ?? {}, child.properties];
  for (const name of Object.keys({ ...before, ...after })) {
    if (before[name] !== after[name]) assign(node, name, after[name]);
  }
  node.given = after;
  fill(node, ...child.children);
  // Set the value of a <select> only now, when it has its options.
  if (before.value !== after.value) node.value = after.value ?? "";
  return node;
}

function assign(element, name, value) {
  if (name === "key") return;
  if (name.startsWith("on")) element[name] = value ?? null;
  else if (name === "style") element.style.cssText = value ?? "";
  else if (value === undefined || value === null || value === false) element.removeAttribute(name);
  else element.setAttribute(name, value === true ? "" : value);
  if (name === "checked") element.checked = Boolean(value);
}

// Show commands, whose lines break between words but not at hyphens.
export function showCode(element, text) {
  fill(element, text.split(/(\s+)/).map((part, k) => (k % 2 ? part : h("span.word", part))));
}

export function table(caption, heads, rows) {
  return h("div.wide", { tabindex: "0", role: "region", "aria-label": caption },
    h("table",
      h("caption.unseen", caption),
      h("thead", h("tr", heads.map((head) => h("th", { scope: "col", class: head.class }, head.text ?? head)))),
      h("tbody", rows.map((row) => h("tr", row.map(cell)))),
    ),
  );
}

const cell = (value, column) => {
  if (value?.tag === "td") return value;
  return column === 0 ? h("th", { scope: "row" }, value) : h("td", value);
};
