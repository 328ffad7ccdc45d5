"""The viewer in the browser: a page that decodes and draws a file, self-contained or from a local server.

`bundle` makes classic scripts from modules, `page` assembles the page, `photographs` embeds photographs, and `server`
serves it. The JavaScript of the page is beside them. README.md describes the design.
"""
