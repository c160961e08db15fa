"""A tool's process, seen from outside.

In: a Python and the module of a tool. Out: answers to requests. A process that ends, says what went wrong or takes too
long raises RuntimeError with one sentence; it never outlives its `with`.
"""

import json
import os
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

_ROOT = Path(__file__).parent.parent.parent
# Appended, not put first: a foreign Python must find its own NumPy before that of our environment.
_START = "import runpy, sys; sys.path.append({root!r}); runpy.run_module({module!r}, run_name='__main__')"
_LOADING = 60.0  # seconds for starting Python and importing


class Process:
    """A running tool; starting several and greeting them afterwards overlaps their imports.

    Parameters
    ----------
    python, module
        The interpreter, and what it runs.
    environment
        Variables that are added to those of this process.
    """

    def __init__(self, python: str, module: str, environment: Mapping[str, str] | None = None) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="peer-")
        self._said = Path(self._folder.name) / "stderr"
        with self._said.open("wb") as errors:
            self._popen = subprocess.Popen(
                [python, "-c", _START.format(root=str(_ROOT), module=module)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                encoding="utf-8",
                cwd=self._folder.name,
                env={**os.environ, **(environment or {})},
            )

    def __enter__(self) -> "Process":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process, whatever it is at."""
        self._popen.kill()
        self._popen.communicate()
        self._folder.cleanup()

    def hello(self) -> str:
        """Wait until the tool is loaded; return its version."""
        return str(self._answer(_LOADING)["version"])

    def ask(self, do: str, limit: float, **request: object) -> dict[str, Any]:
        """Make a request and wait for the answer, at most `limit` seconds.

        Raises
        ------
        RuntimeError
            If the tool reports an error, ends, or takes longer; then it is ended.
        """
        assert self._popen.stdin is not None
        try:
            self._popen.stdin.write(json.dumps({"do": do, **request}) + "\n")
            self._popen.stdin.flush()
        except BrokenPipeError:
            raise RuntimeError(self._end()) from None
        return self._answer(limit)

    def _answer(self, limit: float) -> dict[str, Any]:
        assert self._popen.stdout is not None
        timer = threading.Timer(limit, self._popen.kill)
        timer.start()
        line = self._popen.stdout.readline()
        late = not timer.is_alive()
        timer.cancel()
        if not line:
            raise RuntimeError(f"ended after {limit:g} s without an answer" if late else self._end())
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return answer

    def _end(self) -> str:
        """How the process ended, with its last words."""
        code = self._popen.wait()
        lines = self._said.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        last = f": {lines[-1].strip()}" if lines else ""
        return f"its process ended with {f'signal {-code}' if code < 0 else f'exit code {code}'}{last}"
