"""The frame of every page that rangecam writes: one HTML file that opens offline."""

import base64
import html
from collections.abc import Iterable


def section(title: str, text: str, picture: bytes | str, lines: str = "") -> str:
    """Return a section: heading, a sentence, a PNG (its bytes, or base64 text), and lines as they are."""
    data = picture if isinstance(picture, str) else base64.b64encode(picture).decode("ascii")
    name = html.escape(title)
    below = f"<pre>{html.escape(lines)}</pre>" if lines else ""
    image = f'<img alt="{name}" src="data:image/png;base64,{data}">'
    return f"<section><h2>{name}</h2><p>{html.escape(text)}</p>{image}{below}</section>"


def page(title: str, lead: str, summary: str, sections: Iterable[str]) -> str:
    """Return the page: title, a sentence, a summary as it is, and the sections."""
    body = "\n".join(sections)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>rangecam: {html.escape(title)}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1f2933; background: #f5f7fa; margin: 0 }}
main {{ max-width: 1100px; margin: 0 auto; padding: 24px 20px 60px }}
h1 {{ font-size: 26px; margin: 8px 0 0 }} h2 {{ font-size: 19px; margin: 0 0 4px }}
p {{ margin: 0 0 12px; color: #52606d; max-width: 80ch }}
section {{ background: #fff; border: 1px solid #e4e7eb; border-radius: 8px; padding: 18px 20px; margin: 18px 0 }}
pre {{ font: 13px/1.45 ui-monospace, monospace; white-space: pre-wrap; margin: 0; overflow-wrap: anywhere }}
img {{ max-width: 100%; height: auto; display: block; margin: 0 auto }}
</style></head><body><main>
<h1>{html.escape(title)}</h1>
<p>{html.escape(lead)}</p>
<section><pre>{html.escape(summary)}</pre></section>
{body}
</main></body></html>
"""
