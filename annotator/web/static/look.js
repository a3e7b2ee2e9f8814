// What each browser has of its own: theme, text size, and the list of commands.

const LOOK = "std-annotate-look";
// The range of text sizes, and the actions by their keys.
const { text: TEXT, keys: KEYS } = JSON.parse(document.querySelector("meta[name=look]").content);

function remembered() {
  try {
    const { light, text } = JSON.parse(localStorage.getItem(LOOK)) ?? {};
    const known = Number.isInteger(text) && text >= TEXT.least && text <= TEXT.most;
    return { light: light === true, text: known ? text : TEXT.usual };
  } catch {
    return { light: false, text: TEXT.usual };
  }
}

let look = remembered();

function show() {
  document.documentElement.dataset.theme = look.light ? "light" : "dark";
  document.documentElement.style.setProperty("--text-share", look.text / 100);
}

function tell() {
  document.getElementById("root")?.dispatchEvent(new CustomEvent("look", { detail: look }));
}

function change(wanted) {
  look = { ...look, ...wanted };
  try {
    localStorage.setItem(LOOK, JSON.stringify(look));
  } catch {
    // A private window may have no storage: then it is forgotten with the page.
  }
  show();
  tell();
}

function resize(by) {
  change({ text: Math.min(Math.max(look.text + by, TEXT.least), TEXT.most) });
}

const ACTIONS = {
  light_theme: () => change({ light: !look.light }),
  larger_text: () => resize(TEXT.step),
  smaller_text: () => resize(-TEXT.step),
  panels: () => nextPart(),
  commands: () => document.getElementById("root").dispatchEvent(new CustomEvent("commands")),
};

// Parts of the page whose controls are gone through by keys, and the control that was left last.
const PARTS = [".panels", ".bottom", ".v-app-bar"];
const CONTROLS = "button:enabled, input:enabled, select:enabled, .v-list[tabindex='0']";
let walking = false;
let left = null;

/** Whether the keys were given to the controls: then one that was pressed keeps the focus. */
export function walks() {
  return walking;
}

function nextPart() {
  const at = PARTS.findIndex((part) => document.activeElement.closest(part));
  const firsts = PARTS.slice(at + 1).map((part) => [...document.querySelectorAll(part)]
    .flatMap((found) => [...found.querySelectorAll(CONTROLS)]).find((control) => control.checkVisibility()));
  if (at < 0 && left?.checkVisibility() && !left.disabled) firsts.unshift(left);
  const next = firsts.find(Boolean);
  walking = Boolean(next);
  if (next) next.focus({ focusVisible: true });
  else document.activeElement.blur();
}

// A control that was reached by keys has the plain ones, and Esc leads back to the views.
function controlKey(event, name) {
  const control = event.target.closest?.(PARTS.join());
  if (!walking || !control || name.startsWith("Ctrl+") || /^F\d/.test(name)) return false;
  if (name === "Esc") {
    left = event.target;
    left.blur();
    walking = false;
  }
  return true;
}

// In the list of commands: the field keeps the focus, the keys move the mark.
const MOVES = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10 };

function listKey(event) {
  const rows = [...document.querySelectorAll("#found [role=option]")];
  const at = rows.findIndex((row) => row.ariaSelected === "true");
  if (event.key in MOVES && rows.length) {
    const to = rows[Math.min(Math.max(at + MOVES[event.key], 0), rows.length - 1)];
    to.dispatchEvent(new CustomEvent("mark"));
    to.scrollIntoView({ block: "nearest" });
  } else if (event.key === "Enter") {
    rows[at]?.click();
  } else {
    return;
  }
  event.preventDefault();
}

/** Handle a key that is not for the views; returns whether it was one. */
export function lookKey(event, name) {
  if (event.target.closest?.("#commands")) {
    listKey(event);
    return true;
  }
  if (document.querySelector(".v-overlay--active:is(.v-dialog, .v-menu)")) return false;
  if (!(name in KEYS)) return controlKey(event, name);
  event.preventDefault();
  ACTIONS[KEYS[name]]();
  return true;
}

document.addEventListener("pointerdown", () => { walking = false; }, true);
document.addEventListener("focusin", (event) => {
  if (walking && event.target.closest(PARTS.join())) left = event.target;
});
document.addEventListener("click", (event) => {
  ACTIONS[event.target.closest?.("[data-local]")?.dataset.local]?.();
}, true);

// The page is built after this script has run, and again after a lost connection.
customElements.define("annotator-look", class extends HTMLElement {
  connectedCallback() { tell(); }
});

// Put behind a field that is to have the focus once it is shown.
customElements.define("annotator-focus", class extends HTMLElement {
  connectedCallback() { this.previousElementSibling.focus(); }
});

show();
