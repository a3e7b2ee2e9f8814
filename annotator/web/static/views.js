// The views of the page: they show the pictures that the server sends, and tell it what the hand
// does. One web socket carries all of it, in order and beside everything else of the page.

import { lookKey, walks } from "./look.js";

// So many moves of the pointer may be on their way: on a slow line the pointer is followed in
// larger steps, but not late.
const MOVES_UNDER_WAY = 2;
const SIZE_PAUSE_MS = 80;
const NOTCH_PX = 100;
const DRAGGED = "application/x-std-annotate-";

class Channel {
  constructor() {
    this.views = [];
    this.keys = new Set();
    this.number = 0;
    this.answered = 0;
    this.move = null;
    this.ctrlHeld = false;
    this.sizesTimer = null;
    const url = new URL("views", document.baseURI);
    url.protocol = url.protocol.replace("http", "ws");
    this.socket = new WebSocket(url);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => { this.tellSight(); this.tellSizes(); };
    this.socket.onmessage = (event) => this.receive(event.data);
    this.socket.onclose = () => lost();
    document.addEventListener("visibilitychange", () => this.tellSight());
    window.addEventListener("focus", () => this.tellSizes());
    window.addEventListener("pagehide", () => this.socket.close());
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  receive(data) {
    if (typeof data === "string") {
      const told = JSON.parse(data);
      if (told.keys) this.keys = new Set(told.keys);
      if (told.moved) { this.answered = told.moved; this.flushMove(); }
      return;
    }
    const head = new DataView(data);
    const view = this.views[head.getUint8(0)];
    if (view) view.show(head.getUint32(4, true), new Blob([new Uint8Array(data, 8)], { type: "image/jpeg" }));
  }

  tellSight() {
    this.send({ type: "sight", visible: document.visibilityState === "visible" });
  }

  // While a window is dragged to another size, one size in a while is enough.
  sizesChanged() {
    this.sizesTimer ??= setTimeout(() => { this.sizesTimer = null; this.tellSizes(); }, SIZE_PAUSE_MS);
  }

  tellSizes() {
    const sizes = Array.from(this.views, (view) => (view ? view.size : [0, 0]));
    this.send({ type: "sizes", sizes: sizes, ratio: window.devicePixelRatio });
  }

  // Of the moves that wait, only the last is sent.
  moved(message) {
    this.move = message;
    requestAnimationFrame(() => this.flushMove());
  }

  flushMove(always = false) {
    if (this.move && (always || this.number - this.answered < MOVES_UNDER_WAY)) {
      this.number += 1;
      this.send({ ...this.move, number: this.number });
      this.move = null;
    }
  }

  // Everything but a move comes after the moves before it.
  sendNow(message) {
    this.flushMove(true);
    this.send(message);
  }
}

class AnnotatorView extends HTMLElement {
  connectedCallback() {
    this.index = Number(this.dataset.index);
    this.canvas = document.createElement("canvas");
    this.append(this.canvas);
    this.context = this.canvas.getContext("2d", { alpha: false });
    this.size = [0, 0];
    this.held = null;
    this.turned = 0;
    this.drawing = Promise.resolve();
    channel.views[this.index] = this;
    this.observer = new ResizeObserver((entries) => this.resized(entries[0]));
    try {
      this.observer.observe(this, { box: "device-pixel-content-box" });
    } catch {
      this.observer.observe(this);
    }
    const on = (name, handler) => this.addEventListener(name, handler, { passive: false });
    on("pointerdown", (e) => this.pressed(e));
    on("pointermove", (e) => this.pointed("move", e));
    on("pointerup", (e) => this.released(e));
    on("pointercancel", (e) => this.cancelled(e));
    on("lostpointercapture", (e) => this.cancelled(e));
    on("pointerleave", () => this.held === null && channel.sendNow(this.message("leave")));
    on("dblclick", (e) => this.index > 0 && channel.sendNow(this.message("double", e)));
    on("wheel", (e) => this.wheeled(e));
    on("contextmenu", (e) => e.preventDefault());
    on("dragover", (e) => this.dragged(e));
    on("dragleave", () => this.classList.remove("target"));
    on("drop", (e) => this.dropped(e));
  }

  disconnectedCallback() {
    this.observer.disconnect();
    if (channel.views[this.index] === this) delete channel.views[this.index];
    channel.sizesChanged();
  }

  resized(entry) {
    const { width, height } = entry.contentRect;
    const size = [width, height].map((x) => x * window.devicePixelRatio);
    const box = entry.devicePixelContentBoxSize?.[0];
    // Exact where the ratio is a fraction; where a screen is only played, it knows nothing of it.
    const exact = box && Math.abs(box.inlineSize - size[0]) < 2 && Math.abs(box.blockSize - size[1]) < 2;
    this.size = (exact ? [box.inlineSize, box.blockSize] : size).map(Math.round);
    channel.sizesChanged();
  }

  show(number, blob) {
    const picture = createImageBitmap(blob);
    // Pictures are decoded side by side, and shown in their order.
    this.drawing = Promise.all([picture, this.drawing]).then(([bitmap]) => {
      if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
        this.canvas.width = bitmap.width;
        this.canvas.height = bitmap.height;
      }
      this.context.drawImage(bitmap, 0, 0);
      bitmap.close();
      this.dataset.shown = number;
    }).catch(() => {}).then(() => channel.send({ type: "shown", view: this.index, number: number }));
  }

  // Another page of this session may have views of other proportions: then there is a margin.
  place(event) {
    const box = this.getBoundingClientRect();
    const scale = Math.min(box.width / this.canvas.width, box.height / this.canvas.height);
    const x = event.clientX - box.left - box.width / 2;
    const y = event.clientY - box.top - box.height / 2;
    return { x: x / (scale * this.canvas.width) + 0.5, y: y / (scale * this.canvas.height) + 0.5 };
  }

  message(kind, event) {
    const message = { type: "pointer", view: this.index, kind: kind };
    if (!event) return message;
    return { ...message, ...this.place(event), shift: event.shiftKey,
             ctrl: event.ctrlKey || event.metaKey, alt: event.altKey };
  }

  pressed(event) {
    if (!event.isPrimary || this.held !== null || event.button > 2) return;
    event.preventDefault();
    document.activeElement?.blur();
    this.setPointerCapture(event.pointerId);
    this.held = { pointer: event.pointerId, button: event.button };
    channel.sendNow({ ...this.message("down", event), button: event.button });
  }

  pointed(kind, event) {
    if (event.isPrimary) channel.moved(this.message(kind, event));
  }

  released(event) {
    if (this.held?.pointer !== event.pointerId) return;
    const { button } = this.held;
    this.held = null;
    channel.moved(this.message("move", event));
    channel.sendNow({ ...this.message("up", event), button: button });
  }

  // The browser took the pointer away, as for a gesture of its own: what it did is given up.
  cancelled(event) {
    if (this.held?.pointer !== event.pointerId) return;
    this.held = null;
    channel.sendNow(this.message("cancel"));
  }

  wheeled(event) {
    event.preventDefault();
    const per = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? NOTCH_PX : 3;
    const by = -(event.deltaY || event.deltaX) / per;
    // A wheel turns by whole notches, a touch pad by any amount.
    if (Math.sign(by) !== Math.sign(this.turned)) this.turned = 0;
    this.turned += by;
    const notches = Math.trunc(this.turned + Math.sign(by) * 0.01);
    if (notches === 0) return;
    this.turned -= notches;
    const message = this.message("wheel", event);
    // Pinching a touch pad comes as a wheel with a Ctrl that nobody holds: it zooms.
    message.ctrl = event.metaKey || (event.ctrlKey && channel.ctrlHeld);
    channel.sendNow({ ...message, notches: Math.max(-10, Math.min(10, notches)) });
  }

  dragged(event) {
    if (!Array.from(event.dataTransfer.types).some((type) => type.startsWith(DRAGGED))) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "copy";
    this.classList.add("target");
  }

  dropped(event) {
    this.classList.remove("target");
    for (const what of ["model", "object"]) {
      const name = event.dataTransfer.getData(DRAGGED + what);
      if (name) {
        event.preventDefault();
        channel.sendNow({ type: "drop", view: this.index, ...this.place(event), what: what, name: name });
      }
    }
  }
}

// --- keys ---------------------------------------------------------------------------------------

const NAMES = {
  ArrowLeft: "Left", ArrowRight: "Right", ArrowUp: "Up", ArrowDown: "Down", PageUp: "PgUp",
  PageDown: "PgDown", Escape: "Esc", Enter: "Return", Delete: "Del", " ": "Space",
};

// As the table of actions names it. Whether Shift or AltGr was needed to type a sign is the
// keyboard's business.
function keyName(event) {
  const typed = event.key.length === 1 && !/\p{L}| /u.test(event.key);
  // On a keyboard of another script, the key that is at the place of the Latin letter.
  const key = /^[^\x00-\x7f]$/.test(event.key) && event.code.startsWith("Key") ? event.code[3] : event.key;
  const name = NAMES[key] ?? (key.length === 1 ? key.toUpperCase() : key);
  const altGr = event.getModifierState("AltGraph");
  const parts = [];
  if ((event.ctrlKey || event.metaKey) && !altGr) parts.push("Ctrl");
  if (event.altKey && !altGr) parts.push("Alt");
  if (event.shiftKey && !typed) parts.push("Shift");
  return [...parts, name].join("+");
}

// What is typed into a field is not for the views, nor is anything while a menu or a dialog is open.
function elsewhere(event) {
  return event.target.closest?.("input, textarea, select, [contenteditable]")
    || document.querySelector(".v-overlay--active.v-dialog, .v-overlay--active.v-menu");
}

function keyPressed(event) {
  channel.ctrlHeld = event.ctrlKey;
  if (event.isComposing) return;
  const name = keyName(event);
  if (lookKey(event, name) || elsewhere(event)) return;
  if (!channel.keys.has(name)) return;
  event.preventDefault();
  channel.sendNow({ type: "key", name: name, repeat: event.repeat });
}

// --- what is dragged to the views ---------------------------------------------------------------

function dragBegins(event) {
  const source = event.target.closest?.("[data-drag]");
  if (!source) return;
  event.dataTransfer.setData(DRAGGED + source.dataset.drag, source.dataset.name);
  event.dataTransfer.effectAllowed = "copy";
  const picture = source.querySelector("img");
  if (picture) event.dataTransfer.setDragImage(picture, picture.width / 2, picture.height / 2);
}

// --- the clipboard ------------------------------------------------------------------------------

async function copied(event) {
  const source = event.target.closest?.("[data-copy]");
  if (!source) return;
  try {
    await navigator.clipboard.writeText(source.dataset.copy);
  } catch {
    // Over plain HTTP from another machine there is only the old way.
    const field = document.createElement("textarea");
    field.value = source.dataset.copy;
    document.body.append(field);
    field.select();
    document.execCommand("copy");
    field.remove();
  }
}

// --- the connection -----------------------------------------------------------------------------

let leaving = false;

// Everything is on the server: once it answers, the page begins anew where it was.
async function lost() {
  if (leaving) return;
  leaving = true;
  const cover = document.createElement("div");
  cover.id = "lost";
  const say = (title, text) => {
    cover.innerHTML = "<div><b></b><p></p></div>";
    cover.querySelector("b").textContent = title;
    cover.querySelector("p").textContent = text;
  };
  say("The connection to std-annotate is lost.", "No edit is lost. Trying again…");
  document.body.append(cover);
  for (let wait = 500; ; wait = Math.min(2 * wait, 5000)) {
    await new Promise((done) => setTimeout(done, wait));
    try {
      const answer = await fetch("index.html", { cache: "no-store" });
      if (answer.ok) return location.reload();
      if (answer.status === 401) {
        say("std-annotate was started anew.", "Open the address that it printed: it holds the token.");
      }
    } catch {
      // Still away.
    }
  }
}

window.addEventListener("beforeunload", () => { leaving = true; });

// A page that the server sends elsewhere.
class AnnotatorLeave extends HTMLElement {
  connectedCallback() {
    leaving = true;
    location.assign(new URL(this.dataset.home, document.baseURI));
  }
}

const channel = new Channel();
customElements.define("annotator-leave", AnnotatorLeave);
customElements.define("annotator-view", AnnotatorView);
document.addEventListener("keydown", keyPressed);
document.addEventListener("keyup", (event) => { channel.ctrlHeld = event.ctrlKey; });
document.addEventListener("dragstart", dragBegins);
document.addEventListener("click", copied);
// A button that was clicked would take the next Space and Return.
document.addEventListener("click", (event) => {
  if (!walks() && !event.target.closest?.("input, textarea, .v-dialog")) document.activeElement?.blur();
});
