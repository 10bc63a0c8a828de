"""Files of a measured picture: what was detected, drawn and in numbers, and the measurement."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capsbayes.files.csv_file import text_of_numbers
from capsbayes.files.output_file import together, write_file
from capsbayes.image.detection import Detection
from capsbayes.image.files.picture import Picture
from capsbayes.image.overlay import write_overlay
from capsbayes.measurement import Measurement


def write_detection(out: Path, picture: Picture, detection: Detection, measured: Measurement) -> None:
    """Write the overlay, the outline and the measurement; of a refused capsule, what was detected of it."""
    with together():
        write_overlay(out / "overlay.png", picture, detection)
        if (outline := detection.outline) is not None:
            error = np.hypot(outline.point_error, outline.arc_error)
            columns = np.column_stack([outline.points, outline.normals, error, outline.edge_width])
            names = ("x_px", "y_px", "normal_x", "normal_y", "error_px", "edge_width_px")
            write_file(out / "outline.csv", text_of_numbers(names, columns, "%.4f"))
        if measured.status.ok:
            measured.write(out / "measurement.toml")
            rows = ["quantity,value,error"]
            for name, power, _, _, value, error in detection.table().loc["perimeter":].itertuples():
                unit = f"_over_l{power if power > 1 else ''}" if power else ""
                rows.append(f"{name}{unit},{value:.6g},{error:.2g}")
            write_file(out / "silhouette.csv", "\n".join(rows) + "\n")
