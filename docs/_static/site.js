// Search results quote the text of a page, without the menus above it.
document.addEventListener("DOMContentLoaded", () => {
  if (typeof Search === "undefined") return;
  const text = Search.htmlToText;
  Search.htmlToText = (html, anchor) => {
    const page = new DOMParser().parseFromString(html, "text/html");
    page.querySelectorAll(".bd-header-article, #jb-print-docs-body, .prev-next-footer").forEach((each) => each.remove());
    return text(page.documentElement.outerHTML, anchor);
  };
});

// A long page shows one section at a time, each under its own address; a search in the page still finds all.
const PAGED = /\/(answer|lab-notes)\.html$/;
document.addEventListener("DOMContentLoaded", () => {
  const page = document.querySelector(".bd-article > section");
  if (!PAGED.test(location.pathname) || !page) return;
  const intro = [...page.children].filter((child) => child.tagName !== "SECTION");
  const sections = [...page.querySelectorAll(":scope > section")];
  const list = document.createElement("nav");
  list.className = "sections";
  list.setAttribute("aria-label", "Sections");
  for (const [id, title] of [[page.id, "Start"], ...sections.map((section) => [section.id, section.querySelector("h2").firstChild.textContent])]) {
    const link = document.createElement("a");
    link.href = `#${id}`;
    link.textContent = title;
    list.append(link);
  }
  page.querySelector("h1").after(list);
  const show = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const section = sections.find((each) => each.contains(target));
    for (const each of sections) each.hidden = each === section ? false : "until-found";
    for (const each of intro) each.hidden = each.tagName !== "H1" && section ? "until-found" : false;
    for (const link of list.children) link.toggleAttribute("aria-current", link.hash === `#${(section || page).id}`);
    if (section && target !== section) target.scrollIntoView();
    else if (section) scrollTo(0, 0);
  };
  addEventListener("hashchange", show);
  show();
});
