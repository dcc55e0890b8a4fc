"""A sports engineer opens the joints and the skeleton of a fit in OpenSim, where the person stands upright."""

import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np

BONES = (
    ("PELV", "L3", "T12", "T8", "C7", "HEAD"),
    *((f"{side}HJC", f"{side}KJC", f"{side}AJC", f"{side}TOE") for side in "RL"),
    *(("T8", f"{side}CLAV", f"{side}SJC", f"{side}EJC", f"{side}WJC") for side in "RL"),
    ("RHJC", "PELV", "LHJC"),
)


def main(out: Path) -> None:
    """Fit the embedded example, export it for OpenSim, read that with OpenSim, and draw it.

    Args:
        out: where results go.
    """
    result = str(out / "result")
    subprocess.run(["hfb", "demo", "--camera.tilt-deg", "0", "--out", result], check=True)
    subprocess.run(["hfb", "export", result, "--formats", "trc,mot", "--out", str(out / "export")], check=True)

    import opensim

    folder = out / "export" / "opensim"
    table = opensim.TimeSeriesTableVec3(str(folder / "markers.trc"))
    flat = table.flatten()  # held: its numbers are no copy
    places_m = flat.getMatrix().to_numpy().reshape(table.getNumRows(), -1, 3) / 1000
    markers = dict(zip(table.getColumnLabels(), places_m.swapaxes(0, 1), strict=True))
    trunk = markers["C7"] - markers["PELV"]
    lean = np.degrees(np.arccos(trunk[:, 1] / np.linalg.norm(trunk, axis=1)))  # OpenSim's y is up
    print(f"the trunk leans by {lean.mean():.0f} degrees")
    motion = opensim.TimeSeriesTable(str(folder / "motion.mot"))
    hip = motion.getDependentColumn("hip_adduction_l").to_numpy()

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (standing, bending) = pyplot.subplots(1, 2, figsize=(8, 4))
    for row in (0, -1):
        for bone in BONES:
            line = np.stack([markers[name][row] for name in bone])
            standing.plot(line[:, 0], line[:, 1], color="tab:blue" if row == 0 else "tab:orange")
    standing.set(title="first and last instant", xlabel="x [m]", ylabel="y, up [m]", aspect="equal")
    bending.plot(1000 * np.array(motion.getIndependentColumn()), hip)
    bending.set(title="OpenSim: adduction of the left hip", xlabel="time [ms]", ylabel="angle [degrees]")
    figure.tight_layout()
    figure.savefig(out / "upright.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
