"""Bundles JavaScript modules to one classic script.

A page from a disk cannot load modules, nor can its worker. Thus each module becomes a function in one script. The
supported forms of import and export are those of the project's modules:

    import { a, b as c } from "./other.js";
    export { a } from "./other.js";
    export function a() {}        also: async function, class, const
"""

import re
from pathlib import Path

_IMPORT = re.compile(r'^import \{([^}]*)\} from "(\.[^"]*)";\n', re.MULTILINE)
_PASSED_ON = re.compile(r'^export \{([^}]*)\} from "(\.[^"]*)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:async )?function\*?|class|const) (\w+)", re.MULTILINE)
_LEFT = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)
# The address of a module. No bundle has files beside it.
_PLACE = "import.meta.url"


def bundle(entry: Path) -> str:
    """Returns the script of a module and of those that it imports. Raises ValueError for an unsupported form."""
    done: dict[Path, str] = {}
    begun: list[Path] = []

    def name(path: Path) -> str:
        return f"module_{path.parent.name}_{path.stem}".replace("-", "_")

    def add(path: Path) -> str:
        path = path.resolve()
        if path in done:
            return name(path)
        if path in begun:
            raise ValueError(f"{path.name} imports itself")
        begun.append(path)
        names: list[str] = []

        def imported(match: re.Match[str]) -> str:
            taken = ", ".join(word.strip().replace(" as ", ": ") for word in match[1].split(",") if word.strip())
            return f"const {{ {taken} }} = {add(path.parent / match[2])};\n"

        def passed_on(match: re.Match[str]) -> str:
            source = add(path.parent / match[2])
            taken = [word.strip() for word in match[1].split(",") if word.strip()]
            if any(" as " in word for word in taken):
                raise ValueError(f"{path.name}: export under another name")
            names.extend(f"{word}: {source}.{word}" for word in taken)
            return ""

        def exported(match: re.Match[str]) -> str:
            names.append(match[2])
            return f"{match[1]} {match[2]}"

        text = path.read_text(encoding="utf-8")
        text = _EXPORT.sub(exported, _PASSED_ON.sub(passed_on, _IMPORT.sub(imported, text)))
        if left := _LEFT.search(text):
            raise ValueError(f"{path.name}: {left[0]}")
        text = text.replace(_PLACE, "self.location.href")
        given = f"return {{ {', '.join(names)} }};\n" if names else ""
        done[path] = f"const {name(path)} = (() => {{\n{text}{given}}})();\n"
        return name(path)

    add(entry)
    return '"use strict";\n' + "\n".join(done.values())
