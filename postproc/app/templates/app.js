const drop = document.querySelector(".drop");
const said = document.querySelector("#said");
let adding = false;
async function add(files) {
  let next = "";
  adding = true;
  for (const file of files) {
    said.textContent = `${file.name} is added …`;
    const answer = await fetch(`${drop.dataset.to || "/add"}?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file });
    const content = await answer.json().catch(() => ({ fault: "The window did not answer. Start postproc app again." }));
    if (content.fault) { said.textContent = content.fault; adding = false; return; }
    next = files.length === 1 ? content.next : "/";
  }
  if (next) location.assign(next);
}
if (drop) {
  drop.querySelector("input").addEventListener("change", (event) => add([...event.target.files]));
  for (const kind of ["dragover", "dragleave", "drop"])
    document.addEventListener(kind, (event) => {
      event.preventDefault();
      drop.classList.toggle("over", kind === "dragover");
      if (kind === "drop") add([...event.dataTransfer.files]);
    });
}
const list = document.querySelector("[data-stamp]");
const mark = (part) => `${part.tagName} ${part.getAttribute("href") || part.textContent}`;
// not location.reload(): a dialog that chooses a file stays open, and the focus and the place on the page are kept
async function renew() {
  const page = new DOMParser().parseFromString(await (await fetch("/")).text(), "text/html");
  const focused = mark(document.activeElement);
  const parts = page.querySelectorAll("[data-part]");
  document.querySelectorAll("[data-part]").forEach((part, number) => part.replaceWith(parts[number]));
  list.dataset.stamp = page.querySelector("[data-stamp]").dataset.stamp;
  if (document.activeElement === document.body)
    [...document.querySelectorAll("main a, main button")].find((part) => mark(part) === focused)?.focus({ preventScroll: true });
}
async function look() {
  try {
    const content = await (await fetch("/programs.json")).json();
    for (const [name, share] of Object.entries(content.working)) {
      const place = [...document.querySelectorAll("[data-working]")].find((part) => part.dataset.working === name);
      if (place) place.textContent = share;
    }
    if (content.stamp !== list.dataset.stamp && !adding) await renew();
    if (said.dataset.lost) { said.textContent = ""; delete said.dataset.lost; }
  } catch {
    said.textContent = "The window does not answer. Start postproc app again: what is written is whole.";
    said.dataset.lost = "1";
  }
  setTimeout(look, 1500);
}
if (list) setTimeout(look, 1500);
const output = document.querySelector("pre[data-run]");
async function follow() {
  try {
    const content = await (await fetch(`/run.json?number=${output.dataset.run}`)).json();
    const bar = document.querySelector("#share");
    if (content.share !== null) bar.value = content.share;
    else bar.removeAttribute("value");
    document.querySelector("#step").textContent = content.progress;
    output.textContent = content.text || "It has printed nothing yet.";
    if (content.code !== null) { location.reload(); return; }
  } catch { said.textContent = "The window does not answer. Start postproc app again: what is written is whole."; return; }
  setTimeout(follow, 700);
}
if (output) follow();
const faulty = document.querySelector("[aria-invalid=true]") || document.querySelector("[role=alert]");
if (faulty) faulty.focus();
