// Small helps with the parts of the page.

/** The part of the page with this id. */
export function byId(id) {
  return document.getElementById(id);
}

/** Make a part of the page with properties and what is in it. */
export function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** Put a part at a place of the stage, in CSS pixels. */
export function move(part, {x, y}) {
  part.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
}

/** Show which of several buttons is chosen. */
export function press(chosen, ...others) {
  chosen.setAttribute("aria-pressed", "true");
  for (const other of others) other.setAttribute("aria-pressed", "false");
}

/** Hand a file to the one who asked for it. */
export function save(blob, name) {
  const link = element("a", {href: URL.createObjectURL(blob), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
