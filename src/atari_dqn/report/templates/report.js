"use strict";
const tip = document.getElementById("tip");

function showTip(content, x, y) {
  tip.replaceChildren(...content);
  tip.hidden = false;
  const box = tip.getBoundingClientRect();
  const left = Math.min(Math.max(8, x + 14), document.documentElement.clientWidth - box.width - 8);
  const above = y - box.height - 14;
  tip.style.left = `${left + window.scrollX}px`;
  tip.style.top = `${(above > 8 ? above : y + 22) + window.scrollY}px`;
}
function hideTip() { tip.hidden = true; }
function element(name, text) {
  const made = document.createElement(name);
  made.textContent = text;
  return made;
}

// Buttons that are pressed or not, and say so: [name, whether pressed, what follows a change].
function switches(label, hint, buttons) {
  const group = document.createElement("div");
  group.className = "switches";
  group.setAttribute("role", "group");
  group.setAttribute("aria-label", label);
  group.append(element("span", hint));
  for (const [name, first, change] of buttons) {
    const button = element("button", name);
    let pressed = first;
    const say = () => button.setAttribute("aria-pressed", String(pressed));
    button.type = "button";
    button.addEventListener("click", () => { pressed = !pressed; say(); change(pressed); });
    say();
    group.append(button);
  }
  return group;
}

// What a citation or a reference stands for, on hover and on focus: the entry, the formula, the
// picture or the table's first rows with their caption, or a section's title and first sentence.
const FIRST_ROWS = 5;
function copy(node) {
  const made = node.cloneNode(true);
  for (const named of [made, ...made.querySelectorAll("[id]")]) named.removeAttribute("id");
  return made;
}
function paragraph(...nodes) {
  const made = document.createElement("p");
  made.append(...nodes);
  return made;
}
function preview(target) {
  if (target.matches(".csl-entry")) return [paragraph(...copy(target).childNodes)];
  if (target.matches(".equation")) return [copy(target.querySelector("math"))];
  if (target.matches("h1, h2, h3, h4")) return previewOfSection(target);
  const caption = target.querySelector("figcaption, caption");
  const words = caption ? [paragraph(...copy(caption).childNodes)] : [];
  if (target.matches("table")) {
    const rows = copy(target);
    rows.querySelector("caption")?.remove();
    [...rows.tBodies[0].rows].slice(FIRST_ROWS).forEach((row) => row.remove());
    return [...words, rows];
  }
  const image = target.querySelector("img, video");
  if (!image) return [paragraph(...copy(target).childNodes)];
  const picture = document.createElement("img");
  picture.src = image.poster || image.src;
  picture.alt = "";
  return [picture, ...words];
}
function previewOfSection(heading) {
  const title = document.createElement("strong");
  title.append(...copy(heading).childNodes);
  let next = heading.nextElementSibling;
  while (next && !next.matches("p, h1, h2, h3, h4")) next = next.nextElementSibling;
  if (!next || !next.matches("p")) return [paragraph(title)];
  const words = copy(next);
  words.querySelectorAll("annotation").forEach((source) => source.remove());
  const [sentence] = words.textContent.trim().match(/^.*?[.!?](?=\s+[A-Z]|$)|^.*$/s);
  return [paragraph(title), element("p", sentence)];
}
for (const link of document.querySelectorAll("main a[href^='#']")) {
  const target = document.getElementById(decodeURIComponent(link.hash.slice(1)));
  if (!target) continue;
  const show = () => {
    const box = link.getBoundingClientRect();
    showTip(preview(target), box.left, box.top);
  };
  link.addEventListener("pointerenter", show);
  link.addEventListener("focus", show);
  link.addEventListener("pointerleave", hideTip);
  link.addEventListener("blur", hideTip);
}
document.addEventListener("keydown", (event) => { if (event.key === "Escape") hideTip(); });

// Figures open large, and whole, on a click or with the Enter key; another click shows them larger
// than the window, to scroll and to pinch.
const light = document.getElementById("light");
const lighted = light.querySelector("img");
for (const image of document.querySelectorAll("figure img")) {
  image.tabIndex = 0;
  image.setAttribute("role", "button");
  const open = () => {
    lighted.src = image.src;
    lighted.alt = image.alt;
    lighted.style.setProperty("--ratio", image.naturalWidth / image.naturalHeight);
    light.classList.remove("larger");
    light.showModal();
  };
  image.addEventListener("click", open);
  image.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(); }
  });
}
light.addEventListener("click", (event) => {
  if (event.target === lighted) light.classList.toggle("larger");
  else light.close();
});

// What is wider than the column scrolls within itself, and shows that there is more.
function scrolls(inside) {
  const wide = document.createElement("div");
  const pane = document.createElement("div");
  wide.className = "wide";
  pane.className = "pane";
  inside.replaceWith(wide);
  wide.append(pane);
  pane.append(inside);
  const measure = () => {
    const rest = pane.scrollWidth - pane.clientWidth;
    wide.classList.toggle("before", pane.scrollLeft > 4);
    wide.classList.toggle("after", rest - pane.scrollLeft > 4);
    if (rest > 4) pane.tabIndex = 0;  // so that the keyboard can scroll it
    else pane.removeAttribute("tabindex");
  };
  pane.addEventListener("scroll", measure, { passive: true });
  const resized = new ResizeObserver(measure);
  resized.observe(pane);
  resized.observe(inside);
  return wide;
}
for (const inside of document.querySelectorAll("main figure img, main .formula, main pre")) scrolls(inside);
for (const table of document.querySelectorAll("main table")) {
  const caption = table.querySelector("caption");
  const wide = scrolls(table);
  if (!caption) continue;
  const above = document.createElement("div");
  above.className = "caption";
  above.append(...copy(caption).childNodes);
  wide.before(above);
}

// Videos: no control bar over the picture until the reader points at it; the first one plays by
// itself while it is in view, unless the reader wants no motion or has paused it.
const videos = [...document.querySelectorAll("main video")];
for (const video of videos) {
  video.controls = false;
  video.tabIndex = 0;
  const rest = () => { video.controls = document.activeElement === video; };
  video.addEventListener("pointerenter", (event) => { if (event.pointerType === "mouse") video.controls = true; });
  video.addEventListener("pointerleave", rest);
  video.addEventListener("focus", () => { video.controls = true; });
  video.addEventListener("blur", rest);
  const state = () => video.parentElement.classList.toggle("paused", video.paused);
  video.addEventListener("play", state);
  video.addEventListener("pause", state);
  state();
  const { layer } = video.dataset;
  if (layer) {  // both halves of its pictures play all the time
    const change = (on) => video.classList.toggle("layered", on);
    video.parentElement.after(switches("Layers shown", "Click to show or hide:", [[layer, false, change]]));
  }
}
if (videos.length && !window.matchMedia("(prefers-reduced-motion: reduce)").matches) {
  const [hero] = videos;
  let inView = false;
  const watch = new IntersectionObserver(([entry]) => {
    inView = entry.isIntersecting;
    if (inView) hero.play().catch(() => {});  // a browser that forbids it leaves the still
    else hero.pause();
  }, { threshold: 0.5 });
  hero.addEventListener("pause", () => { if (inView) watch.disconnect(); });
  watch.observe(hero);
}

const entries = new Map();
for (const link of document.querySelectorAll("#contents a")) {
  entries.set(decodeURIComponent(link.hash.slice(1)), link);
}
const column = document.getElementById("contents");
const headings = [...document.querySelectorAll("main h1[id], main h2[id], main section[id]")];
const follow = () => {
  let current = null;
  for (const heading of headings) {
    if (heading.getBoundingClientRect().top < 120 && entries.has(heading.id)) current = heading.id;
  }
  for (const [id, link] of entries) {
    if (id === current) link.setAttribute("aria-current", "true");
    else link.removeAttribute("aria-current");
  }
  const now = entries.get(current);
  if (!now) return;
  const [box, seen] = [now.getBoundingClientRect(), column.getBoundingClientRect()];
  if (box.top < seen.top + 40) column.scrollTop -= seen.top + 40 - box.top;
  else if (box.bottom > seen.bottom - 40) column.scrollTop += box.bottom - seen.bottom + 40;
};
document.addEventListener("scroll", follow, { passive: true });
follow();
const contents = document.querySelector("#contents details");
if (window.matchMedia("(max-width: 74.99rem)").matches) {
  contents.open = false;
  contents.addEventListener("click", (event) => { if (event.target.closest("a")) contents.open = false; });
}
