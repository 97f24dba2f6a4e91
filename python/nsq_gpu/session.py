"""One process of ``nsq-gpu serve`` that stays: it keeps its device and its compiled shaders from trace to trace."""

from __future__ import annotations

import io
import itertools
import json
import os
import queue
import struct
import subprocess
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.arguments import check_mapping, check_scene, of_names
from nsq_gpu.binary import find_binary
from nsq_gpu.color import ColorOf, colored
from nsq_gpu.errors import Interrupted, NsqGpuError, SceneError, TraceTimeoutError, UsageError, error_of, with_partial
from nsq_gpu.export import export, to_json
from nsq_gpu.export.values import whole_number
from nsq_gpu.process import ENDING, LONG_GRACE, TICK, check_not_ending, seconds
from nsq_gpu.progress import Counter, Progress, Shown
from nsq_gpu.results import Result, check_paths, fill_scene, warn_of
from nsq_gpu.scattering import ScatterProb, ScatterTo, answering, keys_of, scattered
from nsq_gpu.sweeps import Point, Sweep, run

Json = dict[str, Any]
Arrays = dict[str, np.ndarray]

#: Version of the messages that this package speaks (docs/reference/serve.md).
PROTOCOL = 1
#: What errors call a scene that no file holds.
EXPORTED = "the exported scene"
#: Bytes of the header, and of all arrays.
_FRAME = struct.Struct("<IQ")
#: How long a trace that was stopped may take to say so before its process is ended [s].
_GRACE = 3.0
#: A message: a header, and bytes of arrays.
_Message = tuple[Json, bytearray]


def as_written(options: Mapping[str, Any]) -> Json:
    """Return options as the program reads them: True is ``on`` and False ``off``. Of recorded paths True is ``all``."""
    on = {"record_paths": "all"}
    off = {"record_paths": None}
    return {name: on.get(name, "on") if value is True else off.get(name, "off") if value is False else value
            for name, value in options.items()}


class Answer:
    """A trace as the program answered it: the report, and arrays by detector (None: of recorded paths)."""

    def __init__(self, header: Json, body: bytearray) -> None:
        self.report: Json = header["report"]
        #: What is said where the target for the error was missed.
        missed = header["missed_target"]
        self.missed_target: str | None = None if missed is None else f"nsq-gpu: {missed}"
        self._arrays: dict[str | None, Arrays] = {}
        at = 0
        for told in header["arrays"]:
            view = memoryview(body)[at : at + told["bytes"]]
            self._arrays.setdefault(told["detector"], {})[told["name"]] = _array(view)
            at += told["bytes"]

    def arrays(self, detector: str | None) -> Arrays:
        """Return the arrays of a detector, or of the recorded paths."""
        return self._arrays.get(detector, {})


class Session:
    """A process of the program that keeps its device and its compiled shaders, so that a trace takes milliseconds.

    Scenes of one shape, which differ in their numbers alone, share a compiled shader. A session is safe to use from
    several threads, whose traces take turns; after a fork each process has a process of the program of its own. An
    interrupt cancels the trace, and the session goes on.

    >>> with Session() as session:
    ...     result = session.trace(scene, 10_000)

    Args:
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        strict: False lets the driver fuse and reorder arithmetic. The default does not, where the adapter allows: results
            are then the same as of ``nsq-gpu trace --strict``, to the bit. The report's ``driver`` says ``strict`` where it holds.
        live: True reads the scene's numbers from a table in every trace, False compiles them in. The default is True in
            traces of at most a million rays: longer ones are faster with numbers compiled in. With strict arithmetic no
            bit of a result depends on it.
    """

    def __init__(self, *, precision: str = "auto", adapter: str | None = None,
                 binary: str | os.PathLike[str] | None = None, strict: bool = True, live: bool | None = None) -> None:
        self._program = find_binary(binary)
        self._adapter = adapter
        self._precision = precision
        self._strict = strict
        self._live = live
        self._lock = threading.Lock()
        #: The process, if one was started. A session that is dropped, and the end of Python, end it: threads hold it.
        self._children: list[_Child] = []
        #: Shapes of scenes whose gradients were checked for light that crosses edges.
        self.checked_shapes: set[str] = set()
        weakref.finalize(self, _end_all, self._children)
        _sessions.add(self)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process. A later trace starts another one."""
        with self._lock:
            children = self._children[:]
            self._children.clear()
        _end_all(children)

    def start(self) -> None:
        """Start the process now, so that the first trace need not wait for it."""
        self._running()

    def trace(self, scene: NSQScene, num_rays: int, *, seed: int = 0, max_depth: int = 16, timeout: float | None = None,
              progress: Progress = None, scatter_prob: ScatterProb = None, scatter_to: ScatterTo = None, color: ColorOf = None,
              **options: Any) -> Result:
        """Trace a scene; return Optiland's result, and leave live detectors as its own backends do.

        Args:
            scene: The live scene.
            num_rays: Rays to launch.
            seed: Seed of the draws.
            max_depth: Largest number of events of a ray.
            timeout: Longest time of the trace [s].
            progress: As in :class:`nsq_gpu.NsqGpuBackend`.
            scatter_prob: As in :class:`nsq_gpu.NsqGpuBackend`.
            scatter_to: As in :class:`nsq_gpu.NsqGpuBackend`.
            color: As in :class:`nsq_gpu.NsqGpuBackend`.
            options: Further options of ``nsq-gpu trace`` by their names, such as ``sampler="sobol"``,
                ``standard_error=True``, ``record_paths=True``, ``paths=True``, ``where="reflections == 2"``,
                ``photometric=True``.

        Raises:
            NsqGpuError: One of its subclasses, by what went wrong.
            Interrupted: Ctrl-C ended the trace. ``partial`` is the result of the rays that were traced, and the live
                detectors hold it too. So it is with TraceTimeoutError.
        """
        keys = keys_of(scatter_prob, scatter_to)
        exported = colored(scattered(export(scene), keys), color)
        options = as_written(options)
        records_paths = options.get("record_paths") is not None
        if records_paths:
            check_paths(scene, exported.surface_labels)
        text = to_json(exported.document, indent=None)
        named = numbers_of_rays(num_rays, seed, max_depth) | options

        def result_of(answer: Answer, partial: bool) -> Result:
            warn_of(answer.report, answer.missed_target)
            return fill_scene(scene, answer.report, answer.arrays, exported.surface_labels, records_paths, partial=partial,
                              text=text)

        with answering(keys), Shown(progress) as shown:
            return self.kept(text, named, result_of, timeout=timeout, progress=shown.of_json, name=EXPORTED)

    def kept(self, scene: str | Json, options: Mapping[str, Any], result_of: Callable[[Answer, bool], Any], **more: Any) -> Any:
        """Return what ``result_of`` makes of a request's answer; of a trace that is stopped, raise it as ``partial``.

        ``result_of`` gets True where the trace was stopped.
        """
        try:
            answer = self.request(scene, options, keeps=True, **more)
        except (Interrupted, TraceTimeoutError) as stop:
            if stop.partial is not None:
                # A stop may come when the last ray is done.
                stop.partial = result_of(stop.partial, bool(stop.partial.report["partial"]))
            raise
        return result_of(answer, False)

    def sweep(self, scene: NSQScene, numbers: Mapping[str, Sequence[float]], num_rays: int, *, zip: bool = False,
              common_draws: bool = True, maps: bool = False, seed: int = 0, max_depth: int = 16,
              timeout: float | None = None, progress: Progress = None, scatter_prob: ScatterProb = None,
              scatter_to: ScatterTo = None, **options: Any) -> Sweep:
        """Trace a scene with every combination of some numbers' values; the live scene stays as it is.

        A point that cannot be traced, such as a lens of negative thickness, is NaN, and NsqGpuWarning names it.

        >>> found = session.sweep(scene, {"L1.r1": np.linspace(50, 60, 11), "L1.z": [0, 1]}, 100_000)
        >>> found.flux["image"].shape
        (11, 2)

        Args:
            scene: The live scene.
            numbers: Values by the names of numbers, such as ``L1.r1``, ``L1.z``, ``lamp.total_flux``, ``screen.width``
                or ``glass.n``: the name of a component, source, detector or medium, and a key of its entry in scene
                files; or ``L4.rx`` of an element, and ``gap_3``. Names with dots are quoted.
            num_rays: Rays of each point.
            zip: True takes the first value of each number together, then the second, and so on.
            common_draws: True draws the same random numbers at all points, so that differences between points have less
                noise; False gives point i the seed plus i.
            maps: True keeps the detectors' maps.
            seed: Seed of the draws.
            max_depth: Largest number of events of a ray.
            timeout: Longest time of the whole sweep [s].
            progress: As in :class:`nsq_gpu.NsqGpuBackend`, with the rays of all points.
            scatter_prob: As in :class:`nsq_gpu.NsqGpuBackend`.
            scatter_to: As in :class:`nsq_gpu.NsqGpuBackend`.
            options: Further options of ``nsq-gpu trace`` by their names.

        Raises:
            NsqGpuError: One of its subclasses, by what went wrong; ``partial`` is the sweep of the points before it.
            Interrupted: Ctrl-C ended the sweep; ``partial`` is the sweep of the points that are done.
        """
        check_mapping("numbers", numbers, '{"L1.r1": [50, 55]}')
        keys = keys_of(scatter_prob, scatter_to)
        text = to_json(scattered(export(scene), keys).document, indent=None)
        timeout = seconds(timeout)
        deadline = None if timeout is None else time.monotonic() + timeout
        known: set[str] = set()

        def trace_all(points: list[Point]) -> Iterator[Answer | NsqGpuError]:
            rays = whole_number("num_rays", num_rays)
            counted = Counter(shown, len(points) * rays)
            for values, index in points:
                named = numbers_of_rays(num_rays, seed + index, max_depth) | options
                left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
                try:
                    with answering(keys):
                        answer = self.request(text, named, name=EXPORTED, numbers=values, timeout=left, progress=counted.of_json)
                except TraceTimeoutError:
                    raise TraceTimeoutError(f"the sweep took longer than timeout = {timeout:g} s and was ended") from None
                except (SceneError, UsageError) as error:
                    found: Answer | NsqGpuError = of_names(error, text, values)
                else:
                    warn_of(answer.report, answer.missed_target, known)
                    found = answer
                counted.add(rays)
                yield found

        with Shown(progress) as shown:
            return run(trace_all, numbers, zip, common_draws, maps)

    def numbers(self, scene: NSQScene | str | Json, names: str | Sequence[str]) -> dict[str, float]:
        """Return numbers of a scene by their names: where an element stands, how wide a gap is.

        >>> session.numbers(scene, ["L4.y", "gap_3"])
        {'L4.y': 0.0, 'gap_3': 6.009}

        Args:
            scene: The live scene, or a scene file's text.
            names: Names, or one name, as in :meth:`sweep`.

        Raises:
            UsageError: A name of nothing.
        """
        text = to_json(export(scene).document, indent=None) if isinstance(scene, NSQScene) else scene
        names = [names] if isinstance(names, str) else list(names)
        header = {"request": "numbers", "scene": text, "names": names}
        values = self._ask(header, None, None)[0]["values"]
        # JSON has no infinite number: the radius of a flat face.
        return {name: float("inf") if value is None else value for name, value in zip(names, values, strict=True)}

    def recoat(self, scene: str | Json, rows: Sequence[Json], coatings: Sequence[Json] = (), *, rank: bool = False,
               folder: str | None = None, split_depth: int = 0) -> Json:
        """Ask what other coatings do to rows of a table of paths; ``nsq-gpu serve`` says what rows and coatings have.

        Returns the answer's header: ``factors`` of the rows, ``recoated``, ``warnings``, and with ``rank`` the ``coatings``.

        Raises:
            UsageError: The rows do not say what such coatings would do.
        """
        header = {"request": "recoat", "scene": scene, "rows": list(rows), "coatings": list(coatings), "rank": rank,
                  "split_depth": split_depth}
        return self._ask(header if folder is None else header | {"folder": folder}, None, None)[0]

    def request(self, scene: str | Json, options: Mapping[str, Any], *, timeout: float | None = None,
                progress: Callable[[Json], None] | None = None, name: str | None = None,
                numbers: Mapping[str, float] | None = None, gradient: Sequence[str] = (),
                gradient_errors: bool = True, gradient_edges: bool = False, folder: str | None = None,
                keeps: bool = False) -> Answer:
        """Trace a scene file's text, with options of ``nsq-gpu trace`` by their names; errors call the scene ``name``.

        ``numbers`` of the scene are set first, by their names. Detectors are differentiated by the numbers that
        ``gradient`` names, with standard errors where ``gradient_errors`` is true, and by differences of two traces as well
        where ``gradient_edges`` is true. Files that the scene names are looked for from ``folder``. With ``keeps``, a stop or a timeout takes the answer of the rays that were traced along, as
        ``partial``.

        Raises:
            NsqGpuError: One of its subclasses, by what went wrong.
            TraceTimeoutError: The trace took longer than ``timeout`` [s], and was cancelled.
        """
        header = self._header(scene, options, name, folder)
        header |= {"set": dict(numbers or {}), "progress": progress is not None}
        if gradient:
            header |= {"gradient": list(gradient), "gradient_errors": gradient_errors, "gradient_edges": gradient_edges}
        if self._live is not None:
            header["live"] = self._live
        try:
            return Answer(*self._ask(header, timeout, progress, keeps=keeps))
        except (Interrupted, TraceTimeoutError) as stop:
            stop.partial = None if stop.partial is None else Answer(*stop.partial)
            raise

    def loss_gradient(self, scene: str | Json, options: Mapping[str, Any], parameters: Sequence[str],
                      adjoints: Mapping[str, np.ndarray], *, timeout: float | None = None,
                      progress: Callable[[Json], None] | None = None, name: str | None = None, folder: str | None = None,
                      edges: bool = False, check_edges: bool = False, numbers: Mapping[str, float] | None = None) -> Json:
        """Differentiate a loss by numbers of a scene file's text: :func:`nsq_gpu.loss_gradient`.

        ``numbers`` of the scene are set first, by their names.

        Returns the answer's header: ``values`` in the order of ``parameters``, ``num_lost``, ``num_forward``. With ``edges``,
        ``with_edges`` has the values by differences of two traces. With ``check_edges``, ``not_confirmed`` has the values that a
        short difference of two traces does not confirm.

        Raises:
            NsqGpuError: One of its subclasses, by what went wrong.
        """
        check_mapping("adjoints", adjoints, '{"image": array}')
        arrays = {detector: _npy(array) for detector, array in adjoints.items()}
        sizes = [{"detector": detector, "bytes": len(array)} for detector, array in arrays.items()]
        header = self._header(scene, options, name, folder) | {"gradient": list(parameters), "adjoints": sizes}
        header |= {"set": dict(numbers or {}), "progress": progress is not None, "gradient_edges": edges, "check_edges": check_edges}
        return self._ask(header, timeout, progress, b"".join(arrays.values()))[0]

    def _header(self, scene: str | Json, options: Mapping[str, Any], name: str | None, folder: str | None) -> Json:
        """Return the header of a request to trace, with options of the session where ``options`` say nothing."""
        named = {"precision": self._precision, **({} if self._strict else {"strict": "off"}), **as_written(options)}
        header = {"request": "trace", "scene": scene, "name": name, "options": named}
        return header if folder is None else header | {"folder": folder}

    def hello(self) -> Json:
        """Return what the process says of itself: its version, its adapter, how many shaders it keeps."""
        return self._ask({"request": "hello"}, None, None)[0]

    def _ask(self, *request: Any, **more: Any) -> _Message:
        """Ask the process, or another one where a thread has ended it meanwhile."""
        while True:
            try:
                return self._running().ask(*request, **more)
            except _Ended:
                continue

    def _running(self) -> _Child:
        check_not_ending()
        with self._lock:
            if not self._children or not self._children[0].is_alive():
                arguments = [] if self._adapter is None else [f"--adapter={self._adapter}"]
                self._children[:] = [_Child([self._program, "serve", *arguments])]
            return self._children[0]


_sessions: weakref.WeakSet[Session] = weakref.WeakSet()
_shared: dict[tuple[str, str | None], Session] = {}
_shared_lock = threading.Lock()


def numbers_of_rays(num_rays: Any, seed: Any, max_depth: Any) -> Json:
    """Return these options as whole numbers, be they written as 1e6."""
    given = {"num_rays": num_rays, "seed": seed, "max_depth": max_depth}
    return {name: whole_number(name, value) for name, value in given.items()}


def shared_session(binary: str, adapter: str | None) -> Session:
    """Return the session of this process on that program and adapter."""
    with _shared_lock:
        key = (binary, adapter)
        if key not in _shared:
            _shared[key] = Session(adapter=adapter, binary=binary)
        return _shared[key]


def asked_of_paths(scene: NSQScene | str | os.PathLike[str], binary: str | None, *, is_text: bool, **asked: Any) -> Json:
    """Ask this process's session of other coatings, for rows of a scene: a live one, its file, or its text."""
    session, folder = shared_session(find_binary(binary), None), None
    if not is_text:
        check_scene(scene, or_path=True)
        if isinstance(scene, NSQScene):
            scene = to_json(export(scene).document, indent=None)
        else:
            path = Path(scene)
            scene, folder = path.read_text(encoding="utf-8"), str(path.parent.absolute())
    return session.recoat(str(scene), asked["rows"], asked["coatings"], rank=asked["rank"], folder=folder,
                          split_depth=asked["split_depth"])


def _end_all(children: list[_Child]) -> None:
    for child in children:
        child.end()


def _after_fork() -> None:
    """Forget what belongs to the parent: its processes, and locks that its other threads may have held."""
    global _shared_lock
    _shared_lock = threading.Lock()
    for session in list(_sessions):
        session._lock = threading.Lock()
        session._children.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


class _Ended(Exception):
    """The process ended before it answered."""


class _Child:
    """The process, and the thread that reads what it answers."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._ids = itertools.count(1)
        self._owner = os.getpid()
        self._turn = threading.Lock()
        #: The thread whose turn it is.
        self._holder: int | None = None
        self._is_ended = False
        self._waiting: dict[int, queue.SimpleQueue[_Message | None]] = {}
        self._outbox: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._said: list[str] = []
        # Ctrl-C interrupts the main thread wherever it is. Were that inside Popen, nobody would hold the child: another
        # thread starts it. And a terminal's Ctrl-C is for this process, which cancels; the child has a group of its own.
        starter = threading.Thread(target=self._start, daemon=True)
        self._started = threading.Event()
        self._failure: BaseException | None = None
        try:
            starter.start()
        except RuntimeError as error:
            # Python is about to end, and starts no more threads.
            raise NsqGpuError(f"{ENDING} ({error})") from None
        try:
            self._started.wait()
        except BaseException:
            self._started.wait()
            if self._failure is None:
                self.end()
            raise
        if self._failure is not None:
            raise self._failure

    def _start(self) -> None:
        try:
            apart = {"start_new_session": True} if os.name != "nt" else {}
            self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                             stderr=subprocess.PIPE, **apart)
            self._reader = threading.Thread(target=self._read, daemon=True)
            self._reader.start()
            self._listener = threading.Thread(target=self._listen, daemon=True)
            self._listener.start()
            # What is sent goes through a thread: a process that does not read would hold the caller for ever, and a
            # Ctrl-C would cut a message in two.
            threading.Thread(target=self._write, daemon=True).start()
        except BaseException as error:
            self._failure = error
        finally:
            self._started.set()

    def is_alive(self) -> bool:
        """Return whether the process still answers."""
        return not self._is_ended and self._reader.is_alive()

    def ask(self, request: Json, timeout: float | None, progress: Callable[[Json], None] | None,
            arrays: bytes = b"", keeps: bool = False) -> _Message:
        """Send a request with its arrays; return the answer. Whatever ends the call early ends the request.

        With ``keeps``, Ctrl-C and a timeout take the message of the rays that were traced along, as ``partial``.
        """
        if self._holder == threading.get_ident():
            raise UsageError("this session is tracing, and a callback of its own cannot trace in it; trace after the call, "
                             "or in another Session")
        number = next(self._ids)
        data = _encoded({"id": number, **request})
        timeout = seconds(timeout)
        deadline = None if timeout is None else time.monotonic() + timeout
        # One request at a time: a cancel of this one would else wait for those before it.
        if not self._turn.acquire(timeout=-1 if timeout is None else max(timeout, 0.0)):
            raise TraceTimeoutError(f"the trace waited longer than timeout = {timeout:g} s for another thread's")
        try:
            if self._is_ended:
                raise _Ended
            self._holder = threading.get_ident()
            return self._ask(number, data + arrays, len(arrays), timeout, deadline, progress, keeps)
        finally:
            self._holder = None
            self._turn.release()

    def _ask(self, number: int, data: bytes, array_bytes: int, timeout: float | None, deadline: float | None,
             progress: Callable[[Json], None] | None, keeps: bool) -> _Message:
        answers: queue.SimpleQueue[_Message | None] = queue.SimpleQueue()
        self._waiting[number] = answers
        is_answered = False
        try:
            self._send(data, array_bytes)
            while True:
                if deadline is not None and time.monotonic() > deadline:
                    raise TraceTimeoutError(f"the trace took longer than timeout = {timeout:g} s and was ended")
                try:
                    answer = answers.get(timeout=TICK)
                except queue.Empty:
                    # The process may have ended before the request was known to the reader.
                    if self.is_alive() or not answers.empty():
                        continue
                    answer = None
                if answer is not None and answer[0]["reply"] == "progress":
                    if progress is not None:
                        progress(answer[0])
                    continue
                is_answered = True
                if answer is None:
                    raise self._end_of_process()
                if answer[0]["reply"] == "error":
                    raise error_of(answer[0]["exit_code"], answer[0]["message"])
                return answer
        except BaseException as error:
            if is_answered:
                raise
            is_kept = keeps and isinstance(error, KeyboardInterrupt | TraceTimeoutError)
            partial = self._stop(number, answers, is_kept)
            if is_kept:
                raise with_partial(error, partial)
            raise
        finally:
            self._waiting.pop(number, None)

    def end(self) -> None:
        """End the process; a fork does not end its parent's."""
        if self._owner != os.getpid():
            return
        self._is_ended = True
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                try:
                    stream.close()
                except OSError:
                    pass

    def _send(self, data: bytes, array_bytes: int = 0) -> None:
        """Send a header and the bytes of arrays after it."""
        self._outbox.put(_FRAME.pack(len(data) - array_bytes, array_bytes) + data)

    def _write(self) -> None:
        stream = self._process.stdin
        assert stream is not None
        try:
            while (message := self._outbox.get()) is not None:
                stream.write(message)
                stream.flush()
        except (OSError, ValueError):
            # The reader sees the end of the process as well, or that its streams were closed.
            pass

    def _stop(self, number: int, answers: queue.SimpleQueue[_Message | None], keeps: bool) -> _Message | None:
        """End a request, and return the message of its rays that were traced; end the process where none comes soon."""
        self._send(_encoded({"id": number, "request": "stop" if keeps else "cancel"}))
        deadline, is_heard = time.monotonic() + _GRACE, False
        while time.monotonic() < deadline:
            try:
                answer = answers.get(timeout=0.05)
            except queue.Empty:
                continue
            if answer is None:
                return None
            if answer[0]["reply"] == "progress" and keeps and not is_heard:
                # Maps and rows of a long trace take a while to come.
                deadline, is_heard = time.monotonic() + LONG_GRACE, True
            if answer[0]["reply"] != "progress":
                return answer if keeps and answer[0]["reply"] == "result" else None
        self.end()
        return None

    def _end_of_process(self) -> NsqGpuError:
        try:
            code = self._process.wait(timeout=_GRACE)
        except subprocess.TimeoutExpired:
            # It runs on, but what it writes makes no sense.
            self._process.kill()
            code = self._process.wait()
        self._listener.join(timeout=5.0)
        said = "\n".join(self._said)
        if code == 0:
            return NsqGpuError(f"{self._command[0]} ended without an error, and without a result: is it nsq-gpu?")
        return error_of(code, said)

    def _read(self) -> None:
        stream = self._process.stdout
        assert stream is not None
        try:
            while True:
                header_bytes, array_bytes = _FRAME.unpack(_exactly(stream, _FRAME.size))
                header = json.loads(bytes(_exactly(stream, header_bytes)))
                body = _exactly(stream, array_bytes)
                answers = self._waiting.get(header.get("id"))
                if answers is not None:
                    answers.put((header, body))
        except (_Ended, OSError, ValueError, struct.error):
            pass
        finally:
            self._outbox.put(None)
            for answers in list(self._waiting.values()):
                answers.put(None)

    def _listen(self) -> None:
        stream = self._process.stderr
        assert stream is not None
        try:
            for line in stream:
                self._said.append(line.decode(errors="replace").rstrip("\n"))
                del self._said[:-100]
        except (OSError, ValueError):
            pass


def _npy(array: np.ndarray) -> bytes:
    """Return an array as it is sent."""
    file = io.BytesIO()
    np.lib.format.write_array(file, np.ascontiguousarray(array, dtype=np.float64), allow_pickle=False)
    return file.getvalue()


def _encoded(header: Json) -> bytes:
    """Return a header as it is sent.

    Raises:
        UsageError: It holds what JSON cannot, such as a NaN.
    """
    def plain(value: Any) -> Any:
        if isinstance(value, (np.generic, np.ndarray)):
            return value.tolist()
        raise UsageError(f"{value!r} is no number and no text")

    try:
        return json.dumps(header, allow_nan=False, default=plain).encode()
    except ValueError as error:
        raise UsageError(f"a number of the request is not finite: {error}") from None


def _exactly(stream: IO[bytes], count: int) -> bytearray:
    data = bytearray(count)
    view, at = memoryview(data), 0
    while at < count:
        read = stream.readinto(view[at:])  # type: ignore[attr-defined]
        if not read:
            raise _Ended
        at += read
    return data


_known_headers: dict[bytes, tuple[np.dtype, tuple[int, ...]]] = {}


def _array(view: memoryview) -> np.ndarray:
    """Return an array of the format ``.npy`` 1.0, which shares the memory that it lies in."""
    length = 10 + int.from_bytes(view[8:10], "little")
    header = bytes(view[:length])
    if header not in _known_headers:
        if len(_known_headers) > 1000:
            _known_headers.clear()
        stream = io.BytesIO(header)
        try:
            np.lib.format.read_magic(stream)
            shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        except ValueError as error:
            raise NsqGpuError(f"an array of the answer is not in the format .npy 1.0: {error}") from None
        _known_headers[header] = dtype, shape
    dtype, shape = _known_headers[header]
    return np.frombuffer(view[length:], dtype=dtype).reshape(shape)
