"""The page of /docs: Swagger UI, vendored in static/ with its licence.
FastAPI's own page loads from a CDN.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

STATIC = Path(__file__).resolve().parent / "static"


@dataclass(frozen=True, slots=True)
class StaticFile:
    """A file that ships with the package."""

    path: Path
    media_type: str


FILES = {
    "swagger-ui.css": StaticFile(STATIC / "swagger-ui.css", "text/css"),
    "swagger-ui-bundle.js": StaticFile(STATIC / "swagger-ui-bundle.js", "text/javascript"),
    "start.js": StaticFile(STATIC / "start.js", "text/javascript"),
}

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>robomend: HTTP interface</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="docs/swagger-ui.css">
</head>
<body>
<div id="api"></div>
<script src="docs/swagger-ui-bundle.js"></script>
<script src="docs/start.js"></script>
</body>
</html>
"""
