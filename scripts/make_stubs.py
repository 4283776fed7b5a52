"""Writes the type stubs of the compiled modules: ``python scripts/make_stubs.py`` (``make stubs``).

``--check`` writes nothing and fails when a committed stub differs from a fresh one.
"""

import argparse
import importlib
import sys
from pathlib import Path

from nanobind.stubgen import StubGen

PACKAGE = Path(__file__).resolve().parent.parent / "src" / "truewrench"


def stub_of(module_name: str) -> str:
    """The stub text of a compiled module."""
    module = importlib.import_module(module_name)
    generator = StubGen(module=module, quiet=True)
    generator.put(module)
    return str(generator.get()).rstrip() + "\n"


def fresh_stubs() -> dict[Path, str]:
    """Every stub the package carries, by path."""
    # Both variants have the same interface; _core.py adds `variant`.
    core = stub_of("truewrench._core_baseline").replace("truewrench._core_baseline", "truewrench._core")
    return {
        PACKAGE / "_core.pyi": core + '\nvariant: str\n"""Which variant is loaded: baseline or avx2."""\n',
        PACKAGE / "_cpu.pyi": stub_of("truewrench._cpu"),
    }


def main() -> int:
    """Writes or checks the stubs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    check = parser.parse_args().check
    stale = []
    for path, text in fresh_stubs().items():
        if not path.exists() or path.read_text() != text:
            stale.append(path.name)
            if not check:
                path.write_text(text)
    if check and stale:
        sys.stderr.write(f"stale stubs: {', '.join(stale)}; run `make stubs`\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
