"""Velocity and lengths measured in drawn films: bias, scatter, coverage of the intervals.

Run ``python -m evidence.benchmarks.films [COUNT]``; ``--speed`` times films of 1280 x 1024 px instead, and ``--memory``
tells how much memory one of 2,000 frames takes.

Each film shows one simulated capsule drawn at random from a shipped
database, with optics and velocity drawn at random, and the empty channel given. In pixels the error of the
velocity is that of the positions of the centroid; over l all errors include that of the half width.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from time import process_time

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from threadpoolctl import threadpool_limits

from capsbayes.database import Database
from capsbayes.experiment import Experiment
from capsbayes.image.files import Film
from capsbayes.image.film import measure_film
from capsbayes.quantity import Quantity
from evidence.benchmarks.pictures import SEED, SETS, row, scenery
from evidence.benchmarks.stored import arguments
from evidence.markdown import table
from evidence.synthetic import Drawing, Optics, Scene, draw

LARGE, LONG = (1024, 1280), 82  # rows and columns, frames
PASSAGE, PASSAGES = 16, 125  # frames of a capsule, capsules one after the other
MEASURED = """
import sys
from pathlib import Path
from capsbayes import Experiment, measure_film
experiment = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
film = measure_film(sys.argv[1], experiment, frame_rate="1000 Hz")
# of this process alone: what getrusage tells begins with the memory of the process that started it
kept = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
peak = int(kept["VmHWM"].split()[0]) / 1024
print(f"{film.frames} frames, {sum(one.status.ok for one in film.capsules)} capsules: {peak:.0f} MB at most")
"""
FRAMES, RATE = 8, Quantity(1000.0, 0.0, "1/s")
EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
NAMES = ("v_o, px a frame", "v_o, l a frame", "L_z, l", "L_a, l")


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=60, help="number of films (default: 60)")
    parser.add_argument("--speed", action="store_true", help="time films of 1280 x 1024 px, a channel 200 px wide")
    parser.add_argument("--memory", action="store_true", help="measure a film of 2,000 frames in a process of its own")
    given = parser.parse_args()
    if given.speed or given.memory:
        (timed if given.speed else remembered)()
        return
    cases = Database.open("square-neo-hookean").converged
    random = np.random.default_rng(SEED)
    errors: dict[str, list[tuple[float, float]]] = {name: [] for name in NAMES}
    statuses: Counter[str] = Counter()
    with threadpool_limits(limits=1):
        for number in track(range(given.count), description="films", transient=True):
            scene, optics = scenery(cases, SETS[list(SETS)[number % len(SETS)]], random)
            statuses.update(measured(scene, optics, random, errors))
    head = ("", "n", "bias", "scatter", "error", "in 68 %", "by chance", "in 95 %", "by chance")
    print(table(head, ((name, *row(1e3 * np.array(pairs))) for name, pairs in errors.items() if pairs)))
    print("In thousandths of a pixel a frame, of l a frame, and of l.")
    print(", ".join(f"{name} {count}" for name, count in statuses.items()))


def timed() -> None:
    """Print the processor time for one capsule that passes a large picture, by kind of file."""
    drawings = passing(LONG)
    frames = [one.picture for one in drawings]
    rows = []
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(limits=1):
        for path in written(Path(folder), frames):
            seconds = []
            for background in (drawings[0].background, drawings[0].background, None):  # the first compiles
                start = process_time()
                film = measure_film(path, EXPERIMENT, frame_rate=RATE, background=background)
                seconds.append(process_time() - start)
                assert [one.status.name for one in film.capsules] == ["DONE"]
            start = process_time()
            count = sum(picture is not None for picture in Film.open(path).frames())
            decoding = (process_time() - start) / count
            per_frame = seconds[1] / count
            once = f"{seconds[2] - seconds[1]:.2f}"
            rows.append((path.name, f"{1e3 * per_frame:.1f}", f"{1e3 * decoding:.1f}", once))
    print(table(("film", "ms a frame", "of them decoding", "s for the background, once"), rows))


def passing(count: int) -> list[Drawing]:
    """Return large pictures of a capsule that passes."""
    random = np.random.default_rng(SEED)
    scene, optics = scenery(Database.open("square-neo-hookean").converged, SETS[next(iter(SETS))], random)
    drawings = []
    for place in track(np.linspace(0.15, 0.85, count)[:: scene.flow], description="frames", transient=True):
        centre = (place * LARGE[1], 0.5 * LARGE[0] + (place - 0.5) * LARGE[1] * np.tan(scene.tilt))
        large = replace(scene, half_width=100.0, shape=LARGE, centre=centre)
        drawings.append(draw(large, optics, seed=int(random.integers(2**31))))
    return drawings


def remembered() -> None:
    """Print how much memory a long film takes, in which one capsule after the other passes; its frames are linked."""
    with tempfile.TemporaryDirectory() as folder:
        for number, drawing in enumerate(passing(PASSAGE)):
            first = Path(folder) / f"{number}.png"
            cv2.imwrite(str(first), drawing.picture)
            for passage in range(1, PASSAGES):
                (Path(folder) / f"{PASSAGE * passage + number}.png").hardlink_to(first)
        subprocess.run([sys.executable, "-c", MEASURED, folder], check=True, cwd=Path(__file__).parent)


def written(folder: Path, frames: list[NDArray[np.uint8]]) -> list[Path]:
    """Write the frames as a video, a TIFF file of many pages, and a folder of pictures."""
    video = cv2.VideoWriter(str(folder / "MJPG.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, LARGE[::-1], False)
    (folder / "PNG").mkdir()
    for number, frame in enumerate(frames):
        video.write(frame)
        cv2.imwrite(str(folder / "PNG" / f"{number}.png"), frame)
    video.release()
    cv2.imwritemulti(str(folder / "TIFF.tif"), frames, [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    return [folder / "MJPG.avi", folder / "TIFF.tif", folder / "PNG"]


def measured(
    scene: Scene, optics: Optics, random: np.random.Generator, errors: dict[str, list[tuple[float, float]]]
) -> list[str]:
    """Film one capsule and record its errors; return the statuses of the capsules measured."""
    step = random.uniform(8.0, 30.0) * scene.flow
    drawings = moved(scene, optics, step, random)
    with tempfile.TemporaryDirectory() as folder:
        for number, one in enumerate(drawings):
            cv2.imwrite(str(Path(folder) / f"{number}.png"), one.picture)
        film = measure_film(folder, EXPERIMENT, frame_rate=RATE, background=drawings[0].background)
    first, half_width, in_l = drawings[0], scene.half_width, 25e-6 * RATE.value
    for capsule in film.capsules:
        if not capsule.status.ok or capsule.velocity is None:
            continue
        seen, speed = capsule.measurement, capsule.velocity
        seen_speed, speed_error = seen.capsule_velocity / in_l, seen.capsule_velocity_error / in_l
        pairs = [(speed.value - step, speed.error), (seen_speed - abs(step) / half_width, speed_error)]
        pairs.append((seen.axial_extent - first.axial_extent / half_width, seen.axial_extent_error))
        if seen.axial_length is not None and seen.axial_length_error is not None:
            pairs.append((seen.axial_length - first.axial_length / half_width, seen.axial_length_error))
        for name, pair in zip(NAMES, pairs, strict=False):  # the last is missing where the rear is not seen
            errors[name].append(pair)
    return [capsule.status.name for capsule in film.capsules]


def moved(scene: Scene, optics: Optics, step: float, random: np.random.Generator) -> list[Drawing]:
    """Return a capsule at eight positions along its channel, in a picture wide enough for all of them."""
    rows, columns = scene.shape[0], int(scene.shape[1] + FRAMES * abs(step))
    along: NDArray[np.float64] = np.array([np.cos(scene.tilt), np.sin(scene.tilt)])
    middle = np.array([0.5 * columns, scene.middle[1]])
    drawings = []
    for number in range(FRAMES):
        centre = middle + (number - 0.5 * (FRAMES - 1)) * step * along
        placed = replace(scene, shape=(rows, columns), centre=(float(centre[0]), float(centre[1])))
        drawings.append(draw(placed, optics, seed=int(random.integers(2**31))))
    return drawings


if __name__ == "__main__":
    main()
