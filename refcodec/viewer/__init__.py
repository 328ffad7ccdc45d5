"""The viewer in the browser: one page that decodes a file and draws it, as a file by itself or from a local server.

`bundle` makes classic scripts of modules, `page` puts the page together, `photographs` embeds photographs, and `server`
serves it. What runs in the page is in JavaScript beside them; README.md says how it works.
"""
