"""The built site: every internal link leads somewhere, every page fits its window."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlsplit

import pytest

import consistent_id

DOCS = Path(__file__).parent.parent / "docs"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
WIDTHS = (1280, 420)
ENOUGH = 60  # pages: a site of fewer was not built completely

# A page that loads all others, one at a time, in a frame of each width, and collects
# - wide: parts of the article that reach beyond the window and cannot be scrolled to;
# - faint: texts with less contrast than AA of WCAG (4.5, large ones 3), in the light
#   theme and in the dark one.
LOOK = """<!doctype html><meta charset="utf-8"><body><script>
const numbers = (c) => (c.match(/[\\d.]+/g) || []).map(Number);
const light = (c) => numbers(c).slice(0, 3)
  .map((v) => v / 255).map((v) => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4)
  .reduce((sum, v, i) => sum + v * [.2126, .7152, .0722][i], 0);
const clear = (c) => { const n = numbers(c); return n.length === 4 && n[3] < .5; };
function contrast(view, element) {
  let behind = element;
  while (behind && clear(view.getComputedStyle(behind).backgroundColor))
    behind = behind.parentElement;
  const white = "rgb(255, 255, 255)";
  const back = behind ? view.getComputedStyle(behind).backgroundColor : white;
  const both = [light(view.getComputedStyle(element).color), light(back)];
  return (Math.max(...both) + .05) / (Math.min(...both) + .05);
}
function scrolled(view, element) {
  for (let e = element.parentElement; e; e = e.parentElement)
    if (["auto", "scroll"].includes(view.getComputedStyle(e).overflowX)) return true;
  return false;
}
const said = (e) =>
  `${e.tagName}.${e.className}: ${e.textContent.trim().slice(0, 60)}`;
const TEXTS = "article *, .sidebar-drawer *, .toc-drawer *";
function look(frame, width) {
  const view = frame.contentWindow, page = view.document, root = page.documentElement;
  const wide = [], faint = [];
  let texts = 0;
  const all = [...page.querySelectorAll("article *")];
  if (root.scrollWidth > root.clientWidth) wide.push(`the page: ${root.scrollWidth}`);
  for (const e of all)
    if (e.getBoundingClientRect().right > width + 1 && !e.closest("math, svg")
        && !scrolled(view, e)) wide.push(said(e));
  for (const theme of ["light", "dark"]) {
    page.body.dataset.theme = theme;
    for (const e of page.querySelectorAll(TEXTS)) {
      const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
      const style = view.getComputedStyle(e);
      if (!own || style.visibility === "hidden" || !e.getClientRects().length) continue;
      texts += 1;
      const size = parseFloat(style.fontSize);
      const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
      const ratio = contrast(view, e);
      if (ratio < (large ? 3 : 4.5))
        faint.push(`${theme} ${ratio.toFixed(2)} ${said(e)}`);
    }
  }
  return {wide: wide.slice(0, 5), faint: faint.slice(0, 5), texts};
}
async function run() {
  const pages = await (await fetch("/pages.json")).json(), found = [];
  for (const width of WIDTHS) for (const name of pages) {
    const frame = document.createElement("iframe");
    frame.style.cssText = `border: 0; height: 900px; width: ${width}px`;
    const loaded = new Promise((done) => frame.addEventListener("load", done));
    frame.src = "/" + name;
    document.body.replaceChildren(frame);
    await loaded;
    found.push({name, width, ...look(frame, width)});
  }
  await fetch("/found", {method: "POST", body: JSON.stringify(found)});
}
run().catch((e) => fetch("/found", {method: "POST", body: JSON.stringify(String(e))}));
</script>"""


class Anchors(HTMLParser):
    """Links and anchors of a page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.names = [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag == "a" and values.get("href"):
            self.links.append(values["href"])
        if tag == "img" and values.get("src"):
            self.links.append(values["src"])
        self.names |= {values[key] for key in ("id", "name") if values.get(key)}


def dead_links(site):
    """Return internal links of the site that lead to no file or no anchor."""
    files = sorted(site.rglob("*.html"))
    anchors = {page.resolve(): Anchors(page.read_text("utf-8")) for page in files}
    dead = []
    for page, found in anchors.items():
        for link in found.links:
            if urlsplit(link).scheme or link.startswith("//"):
                continue
            path, anchor = map(unquote, urldefrag(link))
            path = path.partition("?")[0]
            target = (page.parent / path).resolve() if path else page
            target = target / "index.html" if target.is_dir() else target
            known = anchors[target].names if target in anchors else set()
            if not target.is_file() or (anchor and anchor not in known):
                dead.append(f"{page.relative_to(site.resolve())}: {link}")
    return dead


class Server(SimpleHTTPRequestHandler):
    """Serves the site, the page that looks at it, and takes what was found."""

    def __init__(self, *arguments, names, found, **more):
        self.names, self.found = names, found
        super().__init__(*arguments, **more)

    def do_GET(self):
        own = {
            "/look.html": ("text/html", LOOK.replace("WIDTHS", str(list(WIDTHS)))),
            "/pages.json": ("application/json", json.dumps(self.names)),
        }
        if self.path not in own:
            return super().do_GET()
        kind, text = own[self.path]
        self.answer(kind, text.encode())

    def do_POST(self):
        self.found.append(self.rfile.read(int(self.headers["Content-Length"])))
        self.answer("text/plain", b"")
        self.server.looked.set()

    def answer(self, kind, body):
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


def seen_by(browser, site, names, profile):
    """Return what the browser finds on these pages of the site."""
    found = []
    handler = partial(Server, names=names, found=found, directory=str(site))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.looked = threading.Event()
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/look.html"
        # The sandbox needs rights that root and containers lack; pages are our own.
        options = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run")
        run = subprocess.Popen(
            [browser, *options, f"--user-data-dir={profile}", "--window-size=1400,1000",
             "--remote-debugging-port=0", address],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            assert server.looked.wait(240), "the browser did not answer in 240 s"
        finally:
            run.terminate()
            run.wait(30)
            server.shutdown()
    return json.loads(found[0])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site of today's version beside an older one; .ci/run has built it before."""
    if built := os.environ.get("CONSISTENT_ID_SITE"):
        return Path(built)
    pytest.importorskip("sphinx", reason="the site needs consistent-id[docs]")
    older = tmp_path_factory.mktemp("versions") / "0.0.9"
    older.mkdir()
    (older / "index.html").touch()
    place = older.with_name("today")
    build = [sys.executable, "-m", "sphinx", "-q", str(DOCS), str(place)]
    names = {"CONSISTENT_ID_DOCS_VERSIONS": f"{consistent_id.__version__} 0.0.9"}
    subprocess.run(build, check=True, capture_output=True, env=os.environ | names)
    return place


@pytest.fixture(scope="module")
def chromium():
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no headless browser is installed: {', '.join(BROWSERS)}")
    return found


@pytest.mark.slow
def test_internal_links_lead_to_pages_and_anchors(site):
    assert len(list(site.rglob("*.html"))) > ENOUGH
    assert dead_links(site) == []


@pytest.mark.slow
def test_pages_fit_their_window_and_can_be_read(site, chromium, tmp_path):
    names = sorted(str(page.relative_to(site)) for page in site.rglob("*.html"))
    found = seen_by(chromium, site, names, tmp_path)
    assert len(found) == len(WIDTHS) * len(names) > len(WIDTHS) * ENOUGH
    assert sum(page["texts"] for page in found) > 100 * len(found)
    bad = [page for page in found if page["wide"] or page["faint"]]
    assert bad == []


@pytest.mark.slow
@pytest.mark.parametrize("page", ["index.html", "api/robots.html"])
def test_a_page_says_its_version_and_leads_to_the_others(site, page):
    text = (site / page).read_text()
    assert f"consistent_id {consistent_id.__version__}</title>" in text
    up = "../" * (1 + page.count("/"))
    others = re.search(r'sidebar-versions">(.*?)</div>', text, re.DOTALL)[1]
    assert re.findall(r'href="([^"]*)"', others) == [f"{up}0.0.9/index.html"]


PLAIN = '<body style="{}"><article><h1 id="top">Title</h1>{}</article>'


def test_a_dead_link_is_found(tmp_path):
    links = "".join(
        f'<a href="{link}">x</a>'
        for link in "#top #gone b.html#top b.html#no c.html https://x.y".split()
    )
    (tmp_path / "a.html").write_text(PLAIN.format("", links))
    (tmp_path / "b.html").write_text(PLAIN.format("", '<img src="no.png">'))
    dead = [text.split(": ")[1] for text in dead_links(tmp_path)]
    assert dead == ["#gone", "b.html#no", "c.html", "no.png"]


@pytest.mark.slow
def test_a_wide_table_and_a_faint_text_are_found(chromium, tmp_path):
    wide = '<table style="width: 900px"><tr><td>wide</td></tr></table>'
    parts = {
        "good.html": f'<div style="overflow-x: auto">{wide}</div>',
        "wide.html": wide,
        "faint.html": '<p style="color: #999">faint</p>',
        "grey.html": '<p style="color: #666">grey</p>',
    }
    site = tmp_path / "site"
    site.mkdir()
    for name, part in parts.items():
        (site / name).write_text(PLAIN.format("color: #000; background: #fff", part))
    found = seen_by(chromium, site, sorted(parts), tmp_path / "profile")
    said = {
        (page["name"], page["width"], kind)
        for page in found
        for kind in ("wide", "faint")
        if page[kind]
    }
    faint = {("faint.html", width, "faint") for width in WIDTHS}
    assert said == {("wide.html", 420, "wide"), *faint}
    assert re.search(r"light 2\.8\d", found[0]["faint"][0])
