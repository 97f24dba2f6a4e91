// What a page holds, for docs/site/test_site.py: where its links lead, missing pictures, and what is cut.
const page = location.href.split(/[?#]/)[0];
const scrolls = element => ["auto", "scroll"].includes(getComputedStyle(element).overflowX);
const clips = element => ["hidden", "clip"].includes(getComputedStyle(element).overflowX);

// How far an element reaches beyond what can be seen of it [px]. What lies in a box that scrolls can be seen.
function hidden_width(element) {
  const box = element.getBoundingClientRect();
  if (box.width === 0 || box.height === 0) return 0;
  const inner = clips(element) ? element.scrollWidth - element.clientWidth : 0;
  let right = document.documentElement.clientWidth;
  for (let around = element.parentElement; around && around !== document.body; around = around.parentElement) {
    if (scrolls(around)) return inner;
    if (clips(around)) right = Math.min(right, around.getBoundingClientRect().right);
  }
  return Math.max(inner, box.right - right, -box.left);
}

const decoration = ".headerlink, .sr-only, .visually-hidden, .copybtn, svg *";
return {
  page,
  links: [...document.querySelectorAll("a[href]")].map(a => a.href).filter(href => href.startsWith("file:")),
  missing: [...document.querySelectorAll("img")].filter(img => img.complete && img.naturalWidth === 0).map(img => img.src),
  cut: [...document.querySelectorAll("article *")]
    .filter(element => !element.matches(decoration) && hidden_width(element) > 1)
    .map(element => `${element.tagName.toLowerCase()} ${element.className} lacks ${Math.round(hidden_width(element))} px: `
      + element.textContent.trim().slice(0, 60)),
  search: [...document.querySelectorAll(".search-button, .search-button-field, .search-button__button")]
    .some(button => button.getBoundingClientRect().width > 0 && button.getBoundingClientRect().right <= innerWidth),
};
