"""The tab on which a visitor calibrates a sensor from photos of a pressed ball."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tactile_loc import draw_circle, draw_reading, render_figure

from tactile_loc_app.calibrator import Calibrator, MadeSensor
from tactile_loc_app.errors import AppError
from tactile_loc_app.page.markdown import Paragraph, list_numbered
from tactile_loc_app.page.notices import Notices
from tactile_loc_app.page.pictures import EMPTY
from tactile_loc_app.page.sensor_cover import SensorCover
from tactile_loc_app.uploads import LARGEST_MB, take_upload

if TYPE_CHECKING:
    from viser import ClientHandle

NAME, RADIUS_MM, MM_PER_PX = "my_sensor", 5.0, 0.05
SMALLEST_MM, LARGEST_MM = 1e-4, 1000.0
SHOWN_NAMES, NO_FILE = 4, "-"
HOW_TO = (
    "Press a ball of known radius on the gel about thirty times, all over the gel, and take a photo of each press. "
    "Take one photo without contact, with the same light."
)


class CalibrationTab:
    """Calibrates a sensor with a visitor's `calibrator`. `use` makes the calibrated sensor that of the other tab."""

    def __init__(
        self, client: ClientHandle, calibrator: Calibrator, notices: Notices, use: Callable[[MadeSensor], None]
    ) -> None:
        self.client, self.calibrator, self._notices, self._use = client, calibrator, notices, use
        self.cover = SensorCover(client)
        self._add_photo_controls()
        self._add_length_controls()
        self._add_result_controls()
        self._show_photos()

    def _add_photo_controls(self) -> None:
        gui = self.client.gui
        with gui.add_folder("1. Photos"):
            Paragraph(self.client, HOW_TO)
            self.reference = gui.add_upload_button("Upload the photo without contact", icon="upload")
            self.photos = gui.add_upload_button(
                "Upload photos of the ball",
                hint=f"A photo, a video, or a zip archive of many photos, at most {LARGEST_MB} MB. A table presses.csv "
                "with circles that you measured is used, too.",
            )
            Paragraph(self.client, "For many photos at once, upload a zip archive.")
            self.listed = Paragraph(self.client)
            self.chosen = gui.add_dropdown("File", (NO_FILE,), visible=False)
            self.remove = gui.add_button("Remove this file", visible=False)
            self.clear = gui.add_button("Remove all photos", visible=False)
        self.reference.on_upload(self._notices.guard(self._upload_reference))
        self.photos.on_upload(self._notices.guard(self._upload_photos))
        self.remove.on_click(self._notices.guard(self._remove))
        self.clear.on_click(self._notices.guard(self._clear))

    def _upload_reference(self) -> None:
        self.calibrator.set_reference(*take_upload(self.reference))
        self._show_photos()

    def _upload_photos(self) -> None:
        self.calibrator.add_photos(*take_upload(self.photos))
        self._show_photos()

    def _remove(self) -> None:
        number = self.chosen.options.index(self.chosen.value)
        self.calibrator.remove_photo(self._files[number])
        self._show_photos()

    def _clear(self) -> None:
        self.calibrator.clear()
        self._show_photos()

    def _show_photos(self) -> None:
        reference, names = self.calibrator.reference, self.calibrator.names
        some = ", ".join(names[:SHOWN_NAMES]) + (", ..." if len(names) > SHOWN_NAMES else "")
        shown = f" ({some})" if names else ""
        self.listed.fill("Without contact: {}\n\nPhotos of presses: {}{}", reference or "none yet", len(names), shown)
        self._files = files = [*([] if reference is None else [reference]), *names]
        self.chosen.options = list_numbered(files) or (NO_FILE,)
        self.chosen.value = self.chosen.options[-1]
        for handle in (self.chosen, self.remove, self.clear):
            handle.visible = bool(files)

    def _add_length_controls(self) -> None:
        gui = self.client.gui
        with gui.add_folder("2. Lengths"):
            self.radius = gui.add_number("Ball radius (mm)", RADIUS_MM, min=SMALLEST_MM, max=LARGEST_MM, step=1e-4)
            self.scale = gui.add_number(
                "Size of a pixel (mm)",
                MM_PER_PX,
                min=SMALLEST_MM,
                max=LARGEST_MM,
                step=1e-6,
                hint="Press something of known length on the gel. Divide its length in mm by its length in pixels.",
            )
            self.name = gui.add_text("Name", NAME)

    def _add_result_controls(self) -> None:
        gui = self.client.gui
        with gui.add_folder("3. Calibrate"):
            self.start = gui.add_button("Calibrate", color="green")
            self.bar = gui.add_progress_bar(0.0, visible=False)
            self.status = Paragraph(self.client)
            self.facts = Paragraph(self.client, visible=False)
            self.circle_of = gui.add_slider("Photo", 1, 2, 1, 1, visible=False)
            self.circle = gui.add_image(EMPTY, label="The ball's circle in this photo", visible=False)
            hint = "The picture over the view shows how the sensor reads it."
            self.reading_of = gui.add_slider("Held-out photo", 1, 2, 1, 1, hint=hint, visible=False)
            self.use = gui.add_button("Use this sensor", color="blue", visible=False)
            self.download = gui.add_button("Download the sensor", visible=False)
        self.start.on_click(self._notices.guard(self._calibrate))
        self.circle_of.on_update(self._notices.guard(self._show_circle))
        self.reading_of.on_update(self._notices.guard(self._show_reading))
        self.use.on_click(self._notices.guard(self._use_sensor))
        self.download.on_click(self._notices.guard(self._download))

    def _calibrate(self) -> None:
        """Calibrate in the thread of this callback, so that the page can still be used."""
        self.start.disabled = self.bar.visible = True
        self.status.fill("Calibrating. This takes about half a minute for 50 photos ...")
        try:
            made = self.calibrator.calibrate(self.name.value, self.radius.value, self.scale.value, self._show_progress)
            self._show_made(made)
        finally:
            self.start.disabled = self.bar.visible = False
            self.status.fill("")

    def _show_progress(self, task: str, share: float) -> None:
        self.status.fill("Calibrating: {} ...", task)
        self.bar.value = 100.0 * share

    def _show_made(self, made: MadeSensor) -> None:
        lines = [(line,) for line in made.describe()]
        self.facts.fill("**{}** is calibrated.\n\n", made.folder.name, row="- {}\n", rows=lines)
        circles = 0 if made.labelled.found is None else len(made.labelled.found.presses)
        for slider, count in ((self.circle_of, circles), (self.reading_of, len(made.outcome.held_out))):
            slider.max, slider.value, slider.visible = max(count, 2), 1, count > 1
        self.circle.visible = circles > 0
        for handle in (self.facts, self.use, self.download):
            handle.visible = True
        self._show_circle()
        self._show_reading()

    def _show_circle(self) -> None:
        found = self._require_made().labelled.found
        if found is not None:
            number = min(int(self.circle_of.value), len(found.presses)) - 1
            self.circle.image = render_figure(draw_circle(found, number))

    def _show_reading(self) -> None:
        outcome = self._require_made().outcome
        number = outcome.held_out[min(int(self.reading_of.value), len(outcome.held_out)) - 1]
        self.cover.show(draw_reading(outcome, number))

    def _use_sensor(self) -> None:
        self._use(self._require_made())

    def _download(self) -> None:
        made = self._require_made()
        self.client.send_file_download(f"{made.folder.name}.zip", made.pack(), save_immediately=True)

    def _require_made(self) -> MadeSensor:
        if self.calibrator.made is None:
            raise AppError("there is no calibrated sensor yet; calibrate first")
        return self.calibrator.made
