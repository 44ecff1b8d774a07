// The scene in the room around (AR) by Quick Look, as iPhones and iPads have it: they open a link to a USDZ there, if
// it has a picture in it.

/** True where the browser does that. */
export function hasQuickLook() {
  return document.createElement("a").relList.supports("ar");
}

export class QuickLook {
  /** `button` asks for the file, and `link` takes its place when there is one. */
  constructor(button, link) {
    Object.assign(this, {button, link});
  }

  /** Open a file, and keep the link to it: browsers may want the tap of a finger, and not that of a program. */
  open(usdz, name) {
    this.drop();
    this.url = URL.createObjectURL(new Blob([usdz], {type: "model/vnd.usdz+zip"}));
    this.link.href = `${this.url}#allowsContentScaling=0`; // at its true size
    this.link.download = `${name}.usdz`;
    this.button.hidden = true;
    this.link.hidden = false;
    this.link.focus();
    this.link.click();
  }

  /** Forget the file: it is of another depth. */
  drop() {
    if (!this.url) return;
    URL.revokeObjectURL(this.url);
    this.url = null;
    this.link.removeAttribute("href");
    this.link.hidden = true;
    this.button.hidden = false;
  }
}
