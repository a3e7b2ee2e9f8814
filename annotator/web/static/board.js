// The board of a project: filters, and what others do is shown within seconds.
const REFRESH_MS = 4000;
const live = document.getElementById("live");
let etag = "";

function filter() {
  const sought = document.getElementById("sought").value.toLowerCase().split(/\s+/).filter(Boolean);
  const stage = document.getElementById("stage").value;
  const verdict = document.getElementById("verdict").value;
  let found = 0;
  const cards = live.querySelectorAll(".card");
  for (const card of cards) {
    const shown = (!stage || card.dataset.stage === stage) && (!verdict || card.dataset.verdict === verdict)
      && sought.every((word) => card.dataset.words.includes(word));
    card.hidden = !shown;
    found += shown;
  }
  document.getElementById("found").textContent = found === cards.length ? "" : `${found} of ${cards.length}`;
}

// What a person chose, typed or has the focus on outlives the new content.
function replaceWith(page) {
  const kept = Object.fromEntries(["sought", "stage", "verdict"].map((id) => [id, document.getElementById(id).value]));
  const open = document.getElementById("history").open;
  const focus = document.activeElement?.id;
  const place = document.activeElement?.selectionStart ?? null;
  live.innerHTML = page.getElementById("live").innerHTML;
  for (const [id, value] of Object.entries(kept)) document.getElementById(id).value = value;
  document.getElementById("history").open = open;
  const back = focus && document.getElementById(focus);
  if (back) {
    back.focus({ preventScroll: true });
    if (place !== null && back.type === "search") back.setSelectionRange(place, place);
  }
  filter();
}

async function refresh() {
  if (document.visibilityState === "visible" && !document.querySelector("form.busy")) {
    try {
      const answer = await fetch("/", { headers: etag ? { "If-None-Match": etag } : {}, cache: "no-store" });
      if (answer.ok) {
        etag = answer.headers.get("ETag") ?? "";
        const page = new DOMParser().parseFromString(await answer.text(), "text/html");
        if (page.getElementById("live")?.dataset.version !== live.dataset.version) {
          live.dataset.version = page.getElementById("live").dataset.version;
          replaceWith(page);
        }
      } else if (answer.status === 401) {
        location.reload();
      }
    } catch {
      // The server is away; the next try tells.
    }
  }
  setTimeout(refresh, REFRESH_MS);
}

if (live) {
  etag = `"${live.dataset.version}"`;
  live.addEventListener("input", (event) => { if (event.target.closest(".filters")) filter(); });
  filter();
  setTimeout(refresh, REFRESH_MS);
}

// To open a scene takes seconds: the button says so, and is not pressed twice.
document.addEventListener("submit", (event) => {
  const form = event.target.closest("form.opens");
  if (!form) return;
  form.classList.add("busy");
  const button = form.querySelector("button");
  button.textContent = "Opening…";
  button.setAttribute("aria-disabled", "true");
  for (const other of document.querySelectorAll("form.opens button")) if (other !== button) other.disabled = true;
  const wait = document.querySelector(".wait");
  if (wait) wait.hidden = false;
  form.addEventListener("submit", (again) => again.preventDefault());
});
