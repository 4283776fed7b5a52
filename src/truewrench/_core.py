"""The compiled core, in the variant that suits this processor.

The environment variable ``TRUEWRENCH_CORE`` (``baseline`` or ``avx2``) forces a variant, for tests and for
comparing results between machines.
"""

import os
from importlib import import_module
from importlib.util import find_spec

from truewrench._cpu import supports_x86_64_v3


def _choose_variant(requested: str | None) -> str:
    """Names the variant to load; ``requested`` is the value of ``TRUEWRENCH_CORE``."""
    runs = {"baseline": True, "avx2": supports_x86_64_v3()}
    available = [name for name in runs if runs[name] and find_spec(f"truewrench._core_{name}") is not None]
    if not available:
        raise ImportError("TrueWrench was built for another processor; build it again on this one")
    if requested is None:
        return available[-1]
    if requested not in available:
        raise ImportError(
            f"TRUEWRENCH_CORE={requested!r} cannot be loaded here; expected one of: {', '.join(available)}"
        )
    return requested


variant: str = _choose_variant(os.environ.get("TRUEWRENCH_CORE") or None)
_module = import_module(f"truewrench._core_{variant}")
globals().update({name: value for name, value in vars(_module).items() if not name.startswith("__")})
