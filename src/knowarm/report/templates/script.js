"use strict";
// Colour scheme: the system's until the button is used.
(() => {
  const root = document.documentElement;
  const button = document.querySelector("[data-theme-button]");
  const store = { get: () => { try { return localStorage.getItem("knowarm-theme"); } catch { return null; } },
                  set: (name) => { try { localStorage.setItem("knowarm-theme", name); } catch { /* may be forbidden for file:// */ } } };
  const dark = () => root.classList.contains("dark") ||
    (!root.classList.contains("light") && matchMedia("(prefers-color-scheme: dark)").matches);
  const apply = (name) => { root.classList.remove("light", "dark"); if (name) root.classList.add(name); };
  apply(store.get());
  button.hidden = false;
  button.addEventListener("click", () => { const name = dark() ? "light" : "dark"; apply(name); store.set(name); });
})();

// Pages: show the one in the address; without a script all are shown, one below the other.
(() => {
  const links = new Map([...document.querySelectorAll("nav a")].map((a) => [a.hash.slice(1), a]));
  const pages = [...document.querySelectorAll("main > section")];
  const show = () => {
    const wanted = links.has(location.hash.slice(1)) ? location.hash.slice(1) : pages[0].id;
    for (const page of pages) page.hidden = page.id !== wanted;
    for (const [name, link] of links) {
      if (name === wanted) link.setAttribute("aria-current", "page"); else link.removeAttribute("aria-current");
    }
    const link = links.get(wanted), bar = link.parentElement;
    bar.scrollTo({ left: link.offsetLeft - bar.offsetLeft - 24 });
    window.scrollTo(0, 0);
  };
  window.addEventListener("hashchange", show);
  show();
})();

// Tasks: show the selected one.
(() => {
  const select = document.querySelector("[data-tasks]");
  if (!select) return;
  const parts = [...document.querySelectorAll("[data-part]")];
  const show = () => {
    parts.forEach((part) => { part.hidden = select.value !== "" && part.dataset.part !== select.value; });
    document.querySelectorAll("[data-nothing]").forEach((note) => {
      const own = [...note.parentElement.querySelectorAll("[data-part]")];
      note.hidden = !own.length || own.some((part) => !part.hidden);
    });
  };
  select.hidden = false;
  select.addEventListener("change", show);
  show();
})();

// Legends: a name toggles its series.
document.querySelectorAll("[data-toggle]").forEach((button) => {
  button.addEventListener("click", () => {
    const off = button.getAttribute("aria-pressed") === "true";
    button.setAttribute("aria-pressed", String(!off));
    button.closest("figure").querySelectorAll("[data-name]").forEach((series) => {
      if (series.dataset.name === button.dataset.toggle) series.classList.toggle("off", off);
    });
  });
});

// Films: play and stop.
document.querySelectorAll("[data-play]").forEach((button) => {
  const image = button.querySelector("img");
  const poster = image.src;
  button.addEventListener("click", () => {
    const play = button.getAttribute("aria-pressed") === "false";
    button.setAttribute("aria-pressed", String(play));
    image.src = play ? button.dataset.play : poster;
  });
});

// Line charts: show the values under the pointer.
(() => {
  const tip = document.querySelector(".tip");
  const short = (v) => {
    const size = Math.abs(v);
    if (size >= 1e6) return (v / 1e6).toPrecision(3) + " M";
    if (size >= 1e3) return (v / 1e3).toPrecision(3) + " k";
    return Number(v.toPrecision(3)).toString();
  };
  document.querySelectorAll("svg.lines").forEach((svg) => {
    const [x0, x1, low, high, y0, y1] = svg.dataset.plot.split(" ").map(Number);
    const series = [...svg.querySelectorAll(".series")].map((group) => ({
      group, name: group.dataset.name,
      points: group.dataset.points ? group.dataset.points.split(";").map((p) => p.split(",").map(Number)) : [],
    }));
    const cross = document.createElementNS(svg.namespaceURI, "line");
    cross.setAttribute("class", "cross off");
    cross.setAttribute("y1", y0); cross.setAttribute("y2", y1);
    svg.append(cross);
    const leave = () => { tip.hidden = true; cross.classList.add("off"); };
    svg.addEventListener("pointerleave", leave);
    svg.addEventListener("pointermove", (event) => {
      const place = svg.getBoundingClientRect();
      const pixel = (event.clientX - place.left) * svg.viewBox.baseVal.width / place.width;
      if (pixel < x0 || pixel > x1) return leave();
      const step = low + (pixel - x0) / (x1 - x0) * (high - low);
      const found = series.filter((s) => s.points.length && !s.group.classList.contains("off"))
        .map((s) => [s.name, s.points.reduce((a, b) => Math.abs(b[0] - step) < Math.abs(a[0] - step) ? b : a)])
        .filter(([, p]) => Math.abs(p[0] - step) <= (high - low) / 40);
      if (!found.length) return leave();
      cross.classList.remove("off");
      cross.setAttribute("x1", pixel); cross.setAttribute("x2", pixel);
      tip.replaceChildren();
      const head = document.createElement("b");
      head.textContent = short(step);
      tip.append(head, ...found.flatMap(([name, p]) => [`${name} ${short(p[1])}`, document.createElement("br")]));
      tip.hidden = false;
      tip.style.left = Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8) + "px";
      tip.style.top = event.clientY + 14 + "px";
    });
  });
})();
