"""Cut long recordings into clips: `python cut.py --bvh FOLDER --out FOLDER` (CMU's, as cgspeed converts)."""

import argparse
from pathlib import Path

_SECONDS, _SHORTEST_S = 8.0, 0.7


def main() -> None:
    """Every recording without its first frame, a T-pose, in equal parts of eight seconds at most."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bvh", type=Path, required=True, help="recordings named SUBJECT_TRIAL.bvh")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--hz", type=float, help="of all recordings, where their files say another rate than the true one"
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for path in sorted(options.bvh.rglob("*.bvh")):
        head, body = path.read_text().split("MOTION", 1)
        _, step, *frames = [line for line in body.splitlines() if line.strip()]
        step = f"Frame Time: {1 / options.hz:.8f}" if options.hz else step
        frames, seconds = frames[1:], float(step.split(":")[1])
        parts = max(1, round(len(frames) * seconds / _SECONDS))
        for part in range(parts):
            cut = frames[round(part * len(frames) / parts) : round((part + 1) * len(frames) / parts)]
            if len(cut) * seconds >= _SHORTEST_S:
                letter = f"_{chr(ord('a') + part)}" if parts > 1 else ""
                text = "\n".join([f"{head}MOTION", f"Frames: {len(cut)}", step, *cut, ""])
                (options.out / f"cmu_{path.stem}_daz{letter}.bvh").write_text(text)


if __name__ == "__main__":
    main()
