"""What mkdocs.yml names as its hook; MkDocs loads it by its path, so the repository is put on the path here."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from handbook.site import on_config, on_page_markdown

__all__ = ["on_config", "on_page_markdown"]
