"""How the pages become a site. They are read as they lie in the repository, so that every link means the same in both
places. A broken link or anchor, or a page that docs/site/toc.yml leaves out, fails the build."""

import hashlib
import os
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
BUILT = REPOSITORY / ".docs"
PACKAGE = REPOSITORY / "python"
PROGRAM = Path(os.environ["NSQ_GPU_BINARY"])
sys.path[:0] = [str(Path(__file__).parent), str(PACKAGE)]
# Kernels of notebooks import the package, too.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(PACKAGE), os.environ.get("PYTHONPATH")]))


def traced_by() -> str:
    """What a notebook's output depends on besides its own cells: the program and the package."""
    digest = hashlib.sha256(PROGRAM.read_bytes())
    for source in sorted(PACKAGE.glob("nsq_gpu/**/*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


project = "nsq-gpu"
author = "the authors of nsq-gpu"
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**.md", "benches/**.md", "scenes/*.md"]
exclude_patterns = [".*", "target", "*-out"]
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_external_toc",
    "program_pages",
]
external_toc_path = str(Path(__file__).with_name("toc.yml"))
myst_heading_anchors = 4
myst_links_external_new_tab = False

nb_execution_mode = "cache"
nb_execution_cache_path = str(BUILT / "notebooks" / traced_by())
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 120
# A widget needs a running kernel, and scripts from the net; its text does not.
nb_mime_priority_overrides = [("*", "application/vnd.jupyter.widget-view+json", None)]

autodoc_typehints = "signature"
autodoc_member_order = "groupwise"

# Two dashes are two dashes.
smartquotes = False
# What programs print is no Python.
highlight_language = "text"

html_theme = "sphinx_book_theme"
html_title = "nsq-gpu"
html_static_path = [str(Path(__file__).with_name("static"))]
html_css_files = ["site.css"]
html_extra_path = [str(Path(__file__).with_name("root"))]
html_copy_source = False
html_show_copyright = False
html_search_scorer = str(Path(__file__).with_name("scorer.js"))
html_use_index = False
html_domain_indices = False
html_theme_options = {
    "show_toc_level": 2,
    "home_page_in_toc": True,
    "use_download_button": False,
    "use_fullscreen_button": False,
    # One search is enough: that of the sidebar, on a phone that of the bar above the page.
    "navbar_start": [],
    "navbar_center": [],
    "navbar_end": [],
    "navbar_persistent": [],
}
