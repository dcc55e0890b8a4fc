"""Specification of a method by its name in `--methods` and all that can change its result. Light to import."""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from hfb.config import DirectionsConfig, FitConfig, MultiFrame, Record, RunConfig, Stage, Weights, preset
from hfb.errors import InputError
from hfb.evaluation.baselines.chain_spec import ChainSpec, read_chains
from hfb.io.toml_file import merged, read_toml, to_record
from hfb.networks.mediapipe_files import networks_in_use, sha256_of

Kind = Literal["static", "interpolated", "sfb", "mfb", "fit", "oracle", "middle", "floor", "chain", "own"]
Oracle = Literal["true-matte", "true-start", "true-height", "true-front"]
Estimator = Literal["mediapipe", "matte", "simulated"]

METHOD_NAMES: Mapping[str, str] = {
    "static": "the start, held still through the exposure",
    "interpolated": "the frames' starts at mid-exposure, interpolated over time (one frame: static)",
    "sfb": "Shape from Blur: a deforming sphere in rigid motion, each frame alone; no pose",
    "mfb": "Motion from Blur: the same, one object and one motion through all frames; no pose",
    "best": "Human from Blur, preset best",
    "paper": "Human from Blur, preset paper",
    "oracle-mediapipe": "MediaPipe on the TRUE sharp sub-frames",
    "oracle-matte": "the matte's pose search on the TRUE sharp sub-frames",
    "oracle-simulated": "the simulated estimator, as good as at the lowest blur, on the TRUE sharp sub-frames",
    "oracle-middle": "real video: hfb's start on the TRUE sharp frame in the middle of the exposure, held still",
    "oracle-floor": "the body registered to the true joints: the lowest error that poses can reach",
    "NAME=FILE.toml": "Human from Blur with your own options, as for `hfb fit --config FILE.toml`",
    "NAME=FILE.py:FUNCTION": "a function of your own, of the frames and the starts; its file is run",
}
"""Names of methods with one line each, for the help."""


def _stage_of_all(fit: FitConfig) -> FitConfig:
    last = fit.stages[-1]
    whole = Stage(**last.model_dump() | {"iterations": sum(stage.iterations for stage in fit.stages)})
    return fit.model_copy(update={"stages": (whole,)})


def _with(**changes: Any) -> Callable[[FitConfig], FitConfig]:
    return lambda fit: fit.model_copy(update=changes)


def _without(*weights: str) -> Callable[[FitConfig], FitConfig]:
    none = dict.fromkeys(weights, 0.0)
    return lambda fit: fit.model_copy(update={"weights": fit.weights.model_copy(update=none)})


def _without_evidence(fit: FitConfig) -> FitConfig:
    return _without("joints", "path", "height")(fit).model_copy(update={"settle": 0, "compare": 0.0})


_NAME = re.compile(r"\w[\w.+@-]*")
_VARIANTS: dict[str, Callable[[FitConfig], FitConfig]] = {
    **{f"no-{weight}": _without(weight) for weight in Weights.model_fields},
    "no-pyramid": _stage_of_all,
    "no-kick": _with(initial_root_velocity=0.0),
    "no-evidence": _without_evidence,
    "settled": _with(stages=()),
    "no-lifting": _with(lifting=0.0),
    "no-compare": _with(compare=0.0),
    "no-fusion": _with(fuse_depth=False),
    "no-matte-again": _with(matte_again=False),
    "no-several": _with(multi_frame=MultiFrame()),
    "no-directions": _with(directions=DirectionsConfig()),
    "dibr": _with(silhouette="dibr"),
    "coverage": _with(silhouette="coverage"),
    "axis-angle": _with(rotation="axis-angle"),
    "quaternion": _with(rotation="quaternion"),
    **{f"degree{degree}": _with(degree=degree) for degree in (1, 2, 3, 4)},
}

MODIFIERS: Mapping[str, str] = {
    f"best-no-{{{','.join(Weights.model_fields)}}}": "Human from Blur without one term of its loss; also paper-no-...",
    "best-no-pyramid, best-no-kick": "one stage at full size; no first velocity of the root",
    "best-no-lifting": "without the lifting network, which tells depth from joints across the view",
    "best-no-compare": "the joint network does not look at the fit's own picture",
    "best-no-fusion": "depth by fixed shares of both networks' words and of that look, not by the fusion network",
    "best-no-matte-again": "the mattes stay as they were found before the fit",
    "best-no-several": "of several frames pictures and height count as they do of one",
    "best-no-evidence": "without the joint network; best-settled: with nothing but it, no picture is compared",
    "best-no-directions": "the motion as fitted, no search for its directions",
    "best-dibr, paper-coverage": "the other preset's silhouette",
    "best-axis-angle, paper-quaternion": "the other preset's rotations",
    "best-degree1 ... best-degree4": "another degree of the motion's polynomials",
    "best-frames": "each frame fitted alone, whatever their number",
    "METHOD@true-matte": "an oracle: the exact mattes in place of the estimated ones",
    "METHOD@true-height": "an oracle: a fit that is told how tall the person is (--fit.height-m)",
    "METHOD@true-start": "an oracle: the true body in the middle of each exposure as the start",
    "METHOD@true-front": "an oracle: the start, mirrored in depth where that is nearer to the truth",
}
"""Endings that may be added to a method's name, several of them one after another."""


class FileDigest(Record):
    """A file or folder that a method reads, with its digest."""

    path: Path
    sha256: str


class MethodSpec(Record):
    """The specification of one method: equal specs give equal results on equal cases.

    Attributes:
        name: as the user wrote it, without ``=FILE``; the name in every table.
        function: FILE.py:FUNCTION of the user's own method.
        config: options of a fit; of every other method only the number of sub-frames and the seed count.
        frames_alone: each frame is fitted as if there were no others.
        oracles: parts of the truth that it is given.
        estimator: estimator of a two-stage oracle.
        chain: chain of a deblur-then-estimate method.
        digests: networks, folders and priors it reads, by content: two specs are equal only if these are.
    """

    name: str
    kind: Kind
    config: RunConfig
    frames_alone: bool = False
    oracles: tuple[Oracle, ...] = ()
    estimator: Estimator | None = None
    chain: ChainSpec | None = None
    function: str | None = None
    digests: tuple[FileDigest, ...] = ()

    def files(self) -> list[Path]:
        """Return every file that the method reads, also those in its folders."""
        return [inner for one in self.digests for inner in ([one.path] if one.path.is_file() else _within(one.path))]


def method_spec(text: str, chains: Path | None = None) -> MethodSpec:
    """Parse one entry of `--methods`.

    Args:
        text: an entry such as `best`, `best@true-matte` or `name=FILE`.
        chains: a chains file, whose tables are methods too.

    Raises:
        InputError: no such method, or a file it needs is missing or wrong.
    """
    name, equals, file = text.strip().partition("=")
    if (name or equals) and not _NAME.fullmatch(name):
        raise InputError(f"method {name!r} is to be a folder's name: letters, digits, and . _ + - between them")
    base, *oracles = name.split("@")
    wrong = [oracle for oracle in oracles if oracle not in get_args(Oracle)]
    if wrong:
        known = ", ".join(f"@{oracle}" for oracle in get_args(Oracle))
        raise InputError(f"method {name}: unknown oracle @{wrong[0]}; there are {known}")
    program = program_of(text)
    if program:
        _check_function(file)
        spec = MethodSpec(name=name, kind="own", config=RunConfig(), function=file)
    elif equals:
        spec = MethodSpec(name=name, kind="fit", config=_config_of(Path(file)))
    else:
        spec = _named(base, chains)
    if "true-height" in oracles and spec.kind != "fit":
        raise InputError(f"method {name}: only a fit can be told the person's height")
    if "true-matte" in oracles:  # it is exact: no network finds a better one
        exact = spec.config.fit.model_copy(update={"matte_again": False})
        spec = spec.model_copy(update={"config": spec.config.model_copy(update={"fit": exact})})
    paths = [program] if program else list(spec.chain.paths()) if spec.chain else []
    if spec.kind == "fit":
        paths += [path for path in (spec.config.prior.pose, spec.config.prior.motion) if path is not None]
    if spec.kind == "middle" or "mediapipe" in (spec.estimator, spec.chain.estimator if spec.chain else None):
        paths += networks_in_use()
    paths += [
        data for path in paths if (data := path.with_name(f"{path.name}.data")).is_file()
    ]  # weights of large ONNX
    digests = tuple(FileDigest(path=path, sha256=digest(path)) for path in paths)
    return spec.model_copy(update={"name": name, "oracles": tuple(oracles), "digests": digests})


def program_of(text: str) -> Path | None:
    """Return the file of an entry of `--methods` that names a function, NAME=FILE.py:FUNCTION; None for others.

    Args:
        text: the entry.
    """
    file, colon, _ = text.strip().partition("=")[2].rpartition(":")  # as it is run, to the last blank
    return Path(file) if colon and file.endswith(".py") else None


def _check_function(text: str) -> None:
    """Refuse a file without such a function; it is not run."""
    file, _, name = text.rpartition(":")
    try:
        parsed = ast.parse(Path(file).read_bytes())
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}): a method is a function in it") from None
    except (SyntaxError, ValueError) as error:
        raise InputError(f"{file} is no Python ({error})") from None
    there = [one.name for one in parsed.body if isinstance(one, ast.FunctionDef)]
    if name not in there:
        raise InputError(f"{file} has no function {name!r} at its top level; it has {', '.join(there) or 'none'}")


def _named(base: str, chains: Path | None) -> MethodSpec:
    known = read_chains(chains) if chains else {}
    taken = sorted(set(known) & set(METHOD_NAMES))
    if taken:
        raise InputError(f"{chains}: {taken[0]} is a method already; give this chain another name")
    if base in known:
        return MethodSpec(name=base, kind="chain", config=RunConfig(), chain=known[base])
    if base in ("static", "interpolated", "sfb", "mfb"):
        return MethodSpec.model_validate({"name": base, "kind": base, "config": RunConfig()})
    if base in ("oracle-middle", "oracle-floor"):
        return MethodSpec.model_validate({"name": base, "kind": base.removeprefix("oracle-"), "config": RunConfig()})
    if base.startswith("oracle-") and base in METHOD_NAMES:
        estimator = base.removeprefix("oracle-")
        return MethodSpec.model_validate(
            {"name": base, "kind": "oracle", "config": RunConfig(), "estimator": estimator}
        )
    matched = re.fullmatch(r"(best|paper)((?:-[a-z0-9-]+)?)", base)
    if not matched:
        raise _unknown(base, known)
    config = preset("paper" if matched[1] == "paper" else "best")
    fit, rest, alone = config.fit, matched[2], False
    while rest:
        if rest == "-frames" or rest.startswith("-frames-"):
            rest, alone = rest.removeprefix("-frames"), True
            continue
        fitting = [v for v in _VARIANTS if rest == f"-{v}" or rest.startswith(f"-{v}-")]
        variant = max(fitting, key=len, default=None)  # no-matte-again is not no-matte
        if variant is None:
            raise _unknown(base, known)
        fit, rest = _VARIANTS[variant](fit), rest.removeprefix(f"-{variant}")
    config = config.model_copy(update={"fit": fit})
    return MethodSpec(name=base, kind="fit", config=config, frames_alone=alone)


def _unknown(base: str, chains: Mapping[str, ChainSpec]) -> InputError:
    names = ", ".join([*METHOD_NAMES, *MODIFIERS, *chains])
    hint = "" if chains else "; deblur-then-estimate chains come from --chains FILE.toml"
    return InputError(f"there is no method {base!r}; there are {names}{hint}")


def _config_of(path: Path) -> RunConfig:
    """Return the preset that a file names with the file's entries, of which only a method's own are allowed."""
    content = read_toml(path)
    content = to_record(RunConfig, content, str(path)).model_dump(exclude_unset=True)
    foreign = sorted(set(content) - {"preset", "seed", "fit", "prior"})
    if foreign:
        raise InputError(f"{path}: {foreign[0]} is the same for every method of a benchmark; leave it out of this file")
    return to_record(RunConfig, merged(preset(content.get("preset", "best")).model_dump(), content), str(path))


def _within(folder: Path) -> list[Path]:
    return sorted(one for one in folder.rglob("*") if one.is_file())


def digest(path: Path) -> str:
    """Return the sha256 of a file, or of a folder's files with their names.

    Args:
        path: a file or a folder.

    Raises:
        InputError: nothing lies there, or it cannot be read.
    """
    try:
        if not path.is_dir():
            return sha256_of(path)
        total = hashlib.sha256()
        for inner in _within(path):
            total.update(f"{inner.relative_to(path).as_posix()}\0{digest(inner)}\n".encode())
        return total.hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); a method needs it") from None
