"""The site that `make docs` built, as a reader's browser shows it: Chromium, without a window, from file://.

Each check is first shown a site with that fault. Without Chromium the tests are skipped."""

import os
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from urllib.parse import quote, unquote, urldefrag

import pytest
from bs4 import BeautifulSoup
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

REPOSITORY = Path(__file__).resolve().parents[2]
SITE = REPOSITORY / ".docs/site"
CONFIGURATION = Path(__file__).parent
LOOK = (CONFIGURATION / "looks.js").read_text(encoding="utf-8")
WIDTHS = (1280, 390)
NOTHING_MOVES = """document.head.appendChild(document.createElement("style")).textContent =
    "* { transition: none !important; animation: none !important }" """
DRAWN = "requestAnimationFrame(() => requestAnimationFrame(arguments[0]))"
SEARCH_IS_OVER = "return / found|did not match/.test(document.querySelector('#search-results').textContent)"
#: What users call things, and the page that must be among the first found: that of words, or one of its own.
WORDS = {"PST": "how-to/stray-light"} | dict.fromkeys(("black paint", "light pipe", "TIR", "inch"), "reference/words")
WORDS |= dict.fromkeys(("lux", "candela", "uniformity", "beam angle"), "how-to/illumination")
WORDS |= {"tolerance": "how-to/tolerances", "merit function": "how-to/design", "AR coating": "notebooks/coated_lens", "phosphor": "notebooks/led_color"}

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
in_a_browser = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="chromium and chromedriver are missing")


def lost_lines(markdown: str) -> list[str]:
    """Lines that MyST takes for comments, because they begin with a percent sign outside of code."""
    is_code, lost = False, []
    for line in markdown.splitlines():
        is_code ^= line.lstrip().startswith("```")
        lost += [line] if line.startswith("%") and not is_code else []
    return lost


def test_no_line_of_a_page_is_taken_for_a_comment() -> None:
    assert lost_lines("of 100\n% or more\n```\n% of a shell\n```\n") == ["% or more"]
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    assert {page: lost for page in listed.split() if (lost := lost_lines((REPOSITORY / page).read_text(encoding="utf-8")))} == {}


def test_no_claim_is_on_the_site() -> None:
    claim = re.compile("<!-- (dear )?claim:")
    assert claim.search("A text.\n<!-- dear claim: printed -->\n")
    assert [page.name for page in SITE.rglob("*.html") if claim.search(page.read_text(encoding="utf-8"))] == []


def test_the_lamp_on_the_page_is_that_of_the_example() -> None:
    shown = (REPOSITORY / "docs/how-to/illumination.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    example = (REPOSITORY / "examples/desk_lamp.py").read_text(encoding="utf-8").splitlines()
    assert [line for line in shown.splitlines() if line not in example] == []


@pytest.fixture(scope="session")
def browser():
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options, webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def looked_at(browser, page: Path, widths=WIDTHS) -> list[dict]:
    """What the page holds, at each width of a window [px]."""
    browser.get(page.as_uri())
    browser.execute_script(NOTHING_MOVES)
    found = []
    for width in widths:
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                                {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False})
        browser.execute_async_script(DRAWN)
        found.append({"width": width, **browser.execute_script(LOOK)})
    return found


@pytest.fixture(scope="session")
def pages(browser) -> list[dict]:
    """All pages but the first, which leads to the home."""
    found = sorted(page for page in SITE.rglob("*.html") if "_static" not in page.parts and page != SITE / "index.html")
    return [look for page in found for look in looked_at(browser, page)]


@cache
def places(page: str) -> frozenset[str]:
    soup = BeautifulSoup(Path(page).read_text(encoding="utf-8"), "html.parser")
    return frozenset(element["id"] for element in soup.find_all(id=True))


def dead_links(looks: list[dict]) -> list[str]:
    dead = set()
    for look in looks:
        for link in look["links"]:
            address, place = urldefrag(link)
            target = Path(unquote(address.removeprefix("file://").partition("?")[0]))
            if not target.is_file():
                dead.add(f"{look['page']}: {link}: no such file")
            elif place and target.suffix == ".html" and unquote(place) not in places(str(target)):
                dead.add(f"{look['page']}: {link}: no such place")
    return sorted(dead)


def listed(looks: list[dict], what: str) -> list[str]:
    return [f"{look['page']} at {look['width']} px: {one}" for look in looks for one in look[what]]


def found_by_search(browser, site: Path, word: str) -> list[str]:
    """The pages that the search lists, by their addresses."""
    browser.get((site / "search.html").as_uri() + "?q=" + quote(word))
    WebDriverWait(browser, 20).until(lambda driver: driver.execute_script(SEARCH_IS_OVER))
    return [link.get_attribute("href") for link in browser.find_elements(By.CSS_SELECTOR, "#search-results ul.search a")]


@in_a_browser
def test_every_link_leads_to_a_page_and_a_place(pages):
    assert sum(len(look["links"]) for look in pages) > 1000
    assert dead_links(pages) == []


@in_a_browser
def test_every_picture_is_there(pages):
    assert listed(pages, "missing") == []


@in_a_browser
def test_nothing_is_cut(pages):
    assert listed(pages, "cut") == []


@in_a_browser
def test_the_search_is_in_sight_on_every_page(pages):
    assert [look["page"] for look in pages if not look["search"]] == []


@in_a_browser
def test_the_first_page_leads_to_the_home(browser):
    browser.get((SITE / "index.html").as_uri())
    WebDriverWait(browser, 20).until(lambda driver: driver.current_url == (SITE / "docs/index.html").as_uri())


@in_a_browser
@pytest.mark.parametrize("word", WORDS)
def test_the_search_finds_what_users_call_it(browser, word):
    first = [link.partition("#")[0] for link in found_by_search(browser, SITE, word)][:6]
    assert (SITE / f"docs/{WORDS[word]}.html").as_uri() in first


#: A fault by its name: what is put into a page, and the check that must see it.
FAULTS = {
    "a link to no page": ('<a href="nowhere.html">x</a>', dead_links),
    "a link to no place": ('<a href="ghosts.html#nowhere">x</a>', dead_links),
    "a missing picture": ('<img src="nowhere.png" alt="">', lambda looks: listed(looks, "missing")),
    "a table in a box that hides": (
        '<div style="overflow: hidden"><table style="width: 3000px"><tr><td>x</td></tr></table></div>',
        lambda looks: listed(looks, "cut")),
    "a table wider than the window": (
        '<div><table style="width: 3000px"><tr><td>x</td></tr></table></div>', lambda looks: listed(looks, "cut")),
    "code that hides its end": (
        f'<pre style="overflow: hidden; width: 300px">{"x" * 500}</pre>', lambda looks: listed(looks, "cut")),
}


@in_a_browser
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_noticed(browser, tmp_path, fault):
    put, check = FAULTS[fault]
    site = faulty_site(tmp_path)
    page = site / "docs/how-to/ghosts.html"
    text = page.read_text(encoding="utf-8")
    page.unlink()
    page.write_text(text.replace("</article>", put + "</article>"), encoding="utf-8")
    assert "</article>" in text
    assert check(looked_at(browser, page)) != []


@in_a_browser
def test_a_search_that_lost_a_word_is_noticed(browser, tmp_path):
    site = faulty_site(tmp_path)
    index = site / "searchindex.js"
    text = index.read_text(encoding="utf-8")
    assert '"candela":' in text
    index.unlink()
    index.write_text(text.replace('"candela":', '"x":'), encoding="utf-8")
    assert found_by_search(browser, site, "candela") == []


def faulty_site(folder: Path) -> Path:
    """The site once more, by links: a file that is to be changed is replaced."""
    return Path(shutil.copytree(SITE, folder / "site", copy_function=os.link))


#: A small site by the configuration of the real one: what its page holds, and what the build says of it.
BUILDS = {
    "a good page": ("# A page\n", None),
    "a link to no file": ("# A page\n\n[x](nowhere.md)\n", "nowhere.md"),
    "a link to no place": ("# A page\n\n[x](#nowhere)\n", "nowhere"),
    "a missing picture": ("# A page\n\n![x](nowhere.png)\n", "nowhere.png"),
    "a marker that is misspelt": ("# A page\n\n<!-- site: optoins -->\n", "`site: optoins` is not known"),
    "a notebook that fails": (
        "---\nfile_format: mystnb\nkernelspec: {name: python3}\n---\n\n# A page\n\n```{code-cell} ipython3\n1 / 0\n```\n",
        "ZeroDivisionError"),
}


@pytest.mark.parametrize("case", BUILDS)
def test_the_build_ends_at_a_fault(tmp_path, case):
    text, fault = BUILDS[case]
    built = build(tmp_path, {"index": "# Home\n", "page": text}, ["page"])
    assert (built.returncode == 0) == (fault is None), built.stderr
    assert fault is None or fault in built.stderr


def test_the_build_ends_at_a_page_without_a_place(tmp_path):
    built = build(tmp_path, {"index": "# Home\n", "page": "# A page\n"}, [])
    assert built.returncode != 0
    assert "isn't included in any toctree" in built.stderr


def test_a_notebook_is_run_and_shown(tmp_path):
    cells = "---\nfile_format: mystnb\nkernelspec: {name: python3}\n---\n\n# A page\n\n```{code-cell} ipython3\nprint(6 * 7)\n```\n"
    built = build(tmp_path, {"index": "# Home\n", "page": cells}, ["page"], builder="html")
    assert built.returncode == 0, built.stderr
    assert ">42\n" in (tmp_path / "built/docs/page.html").read_text(encoding="utf-8")


def build(folder: Path, pages: dict[str, str], listed: list[str], builder="dummy") -> subprocess.CompletedProcess:
    docs = folder / "source/docs"
    docs.mkdir(parents=True)
    for name, text in pages.items():
        (docs / f"{name}.md").write_text(text, encoding="utf-8")
    toc = folder / "toc.yml"
    toc.write_text("root: docs/index\n" + ("entries:\n" if listed else "")
                   + "".join(f"  - file: docs/{name}\n" for name in listed), encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", builder, "-c", str(CONFIGURATION),
               "-D", f"external_toc_path={toc}", "-D", f"nb_execution_cache_path={folder / 'cache'}",
               str(folder / "source"), str(folder / "built")]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)
