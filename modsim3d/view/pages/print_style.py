"""How pages are printed: A4, light, with page numbers, and with everything that is folded on the screen."""

from __future__ import annotations

import hashlib
import re

LIGHT = (
    "--ink: #1c2329; --paper: #ffffff; --soft: #56606a; --line: #c4cacf; --bad: #b3261e; "
    "--card: #ffffff; --track: #eceef0;"
)
"""Colours of paper, for both kinds of pages."""

PRINT_STYLE = """
@media not print { .in-print { display: none; } }
@media print {
  :root, :root[data-theme] { color-scheme: light; LIGHT }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { font-size: 10pt; max-width: none; margin: 0; padding: 0; }
  h1 { font-size: 15pt; } h2 { font-size: 12pt; } h3 { font-size: 10.5pt; }
  h1, h2, h3, summary { break-after: avoid; }
  p { orphans: 3; widows: 3; }
  table { font-size: 8pt; } thead { display: table-header-group; }
  td, th { padding-right: 0.6rem; }
  tr, figure, svg, img, dl > div, .rests-on { break-inside: avoid; }
  figure svg:has(+ svg), figure svg + svg, body .plots figure { width: 48%; }
  .rests-on > p.soft, .signature { break-before: avoid; break-inside: avoid; }
  h3 + p.soft { break-after: avoid; } table.dense { font-size: 7pt; } .dense .whole { white-space: normal; }
  figure img, figure svg, svg { max-width: 100%; max-height: 24cm; }
  details::details-content { content-visibility: visible; display: block; block-size: auto; overflow: visible; }
  summary { list-style: none; font-weight: 600; } summary::-webkit-details-marker { display: none; }
  div[style*="overflow"], .scroll { overflow: visible !important; }
  .not-in-print, .player, noscript, button { display: none !important; }
  a { color: inherit; text-decoration: none; }
}
""".replace("LIGHT", LIGHT)
"""Style of printed pages; it stands behind the style of the screen."""


def mark_of(content: str) -> str:
    """What all sheets of a page have in common: the first digits of the checksum of its content."""
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()[:12]


def sheet_style(title: str, mark: str) -> str:
    """Style of the sheets: what stands at the foot of each.

    Args:
        title: Stands on the left.
        mark: What all sheets of one page have in common; in the middle.
    """
    font = "font: 8pt system-ui, sans-serif; color: #56606a;"
    return (
        f"@page {{ size: A4; margin: 15mm 15mm 18mm; "
        f"@bottom-left {{ content: {_css_text(title)}; {font} }} "
        f"@bottom-center {{ content: {_css_text(mark)}; {font} }} "
        f'@bottom-right {{ content: counter(page) " / " counter(pages); {font} }} }}\n'
    )


def _css_text(text: str) -> str:
    """Text as a string of CSS; what could end it or the style is written by its code."""
    return '"' + re.sub(r"[^\w .,:;?!()%/+·–-]", lambda found: f"\\{ord(found[0]):x} ", text) + '"'
