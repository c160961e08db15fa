"""A grid as one web page that traces rays over it: no network, no server, no installation.

In: a grid, an image. Out: `viewer.html`, with the samples as float16 and the programs that draw them (WebGL2).
"""

from sdfbake.view.page import view

__all__ = ["view"]
