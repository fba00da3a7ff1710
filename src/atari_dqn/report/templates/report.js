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

// What a citation or a reference to a figure, table or section stands for, on hover and on focus.
function preview(target) {
  const entry = target.closest(".csl-entry");
  if (entry) return [element("p", entry.textContent)];
  const image = target.querySelector("figure img, img, video");
  const caption = target.querySelector("figcaption, caption");
  if (!image && !caption) return [element("p", target.textContent.trim().slice(0, 300))];
  const parts = [];
  if (image) {
    const copy = document.createElement("img");
    copy.src = image.poster || image.src;
    copy.alt = "";
    parts.push(copy);
  }
  if (caption) parts.push(element("p", caption.textContent));
  return parts;
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

// Figures open large on a click or with the Enter key.
const light = document.getElementById("light");
for (const image of document.querySelectorAll("figure img")) {
  image.tabIndex = 0;
  image.setAttribute("role", "button");
  const open = () => {
    const large = document.createElement("img");
    large.src = image.src;
    large.alt = image.alt;
    light.querySelector("div").replaceChildren(large);
    light.showModal();
  };
  image.addEventListener("click", open);
  image.addEventListener("keydown", (event) => {
    if (event.key === "Enter" || event.key === " ") { event.preventDefault(); open(); }
  });
}
light.addEventListener("click", () => light.close());

// Wide tables scroll within themselves; the contents follow the reader.
for (const table of document.querySelectorAll("main table")) {
  const wide = document.createElement("div");
  wide.className = "wide";
  table.replaceWith(wide);
  const caption = table.querySelector("caption");
  if (caption) {
    const above = document.createElement("div");
    above.className = "caption";
    above.append(...caption.cloneNode(true).childNodes);
    wide.before(above);
  }
  wide.append(table);
  const measure = () => {
    const more = wide.scrollWidth - wide.clientWidth - wide.scrollLeft > 4;
    wide.classList.toggle("more", more);
    if (more) wide.tabIndex = 0;  // so that the keyboard can scroll it
  };
  wide.addEventListener("scroll", measure, { passive: true });
  window.addEventListener("resize", measure);
  measure();
}
const entries = new Map();
for (const link of document.querySelectorAll("#contents a")) {
  entries.set(decodeURIComponent(link.hash.slice(1)), link);
}
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
};
document.addEventListener("scroll", follow, { passive: true });
follow();
const contents = document.querySelector("#contents details");
if (window.matchMedia("(max-width: 74.99rem)").matches) {
  contents.open = false;
  contents.addEventListener("click", (event) => { if (event.target.closest("a")) contents.open = false; });
}
