"""The controls of the page: object, sensor, press, touches, result, prior and export of one visitor."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, get_args

import numpy as np
from tactile_loc import DEMO_OBJECTS, Localization, Units
from tactile_loc.commands import format_mm, format_percent
from tactile_loc.plugin import registry
from tactile_loc.plugin.helpers import NoiseLevel

from tactile_loc_app.calibrator import MadeSensor
from tactile_loc_app.errors import AppError
from tactile_loc_app.page.calibration_tab import CalibrationTab
from tactile_loc_app.page.file_controls import FileControls
from tactile_loc_app.page.follower import Follower
from tactile_loc_app.page.markdown import Paragraph, list_numbered
from tactile_loc_app.page.notices import Notices
from tactile_loc_app.page.overlay import Overlay
from tactile_loc_app.page.pictures import EMPTY, paint_beside, paint_wide
from tactile_loc_app.page.scene_view import SceneView, choose_magnification, from_view
from tactile_loc_app.session import Session
from tactile_loc_app.uploads import limit_uploads, take_upload
from tactile_loc_app.virtual_finger import Pose

if TYPE_CHECKING:
    from viser import ClientHandle

OWN, NO_TOUCH = "own file", "-"
READ_FROM_PATHS = ("file", "calibrated")  # sensors that are chosen by their path
ARCHIVE = "tactile-loc-result.zip"
PRIOR_MM, PRIOR_DEG = 5.0, 15.0
BRAND = (45, 95, 155)
PLAIN: dict[str, Any] = {"color": "gray"}  # of buttons that are not the next step
READY = "Locate the object, or add another touch."
START = "Drag the finger over the object, and add this touch. An edge or a corner tells most."


class VisitorPage:
    """The controls and the view of one visitor, with the visitor's session."""

    def __init__(self, client: ClientHandle, session: Session) -> None:
        self.client, self.session, self.view = client, session, SceneView(client)
        self.notices = Notices(client, session.folder)
        self.follower: Follower[tuple[Pose, float]] = Follower(self._follow)
        try:
            limit_uploads(client, self.notices.show_error)
            self._add_controls()
            self._show_object()
            if session.result is not None:  # of a page that was loaded again
                self._show_result(session.result)
        except BaseException:  # the visitor may have left
            self.close()
            raise

    def _add_controls(self) -> None:
        client, session = self.client, self.session
        client.gui.configure_theme(control_width="large", show_share_button=False, show_logo=False, brand_color=BRAND)
        client.gui.main_panel.dock_right()
        tabs = client.gui.add_tab_group()
        with tabs.add_tab("Locate"):
            self.overlay = Overlay(client)  # in the tab, so that it is hidden with it
            self._add_buttons()
            self._add_object_controls()
            self._add_press_controls()
            self._add_result_controls()
            self.files = FileControls(client, session, self.notices, self._show_touches)
            self._add_prior_controls()
        with tabs.add_tab("Calibrate a sensor"):
            self.calibration = CalibrationTab(client, session.calibrator, self.notices, self._use_calibrated)

    def close(self) -> None:
        """End the visitor's thread. The session goes on."""
        self.follower.stop()

    def _add_buttons(self) -> None:
        """Add the steps from a touch to a result, where they are always visible."""
        gui = self.client.gui
        self.add = gui.add_button("Add this touch", icon="plus")
        self.locate = gui.add_button("Locate", color="green", icon="current-location")
        self.next = gui.add_button("Suggest the next touch", icon="hand-finger", disabled=True, **PLAIN)
        hint = "result.json, report.html, the touches, and a Python script."
        self.export = gui.add_button("Download the result", icon="download", hint=hint, disabled=True, **PLAIN)
        self.add.on_click(self.notices.guard(self._add_touch))
        self.locate.on_click(self.notices.guard(self._locate))
        self.next.on_click(self.notices.guard(self._suggest_next))
        self.export.on_click(self.notices.guard(self._export))

    # object and sensor

    def _add_object_controls(self) -> None:
        gui, config = self.client.gui, self.session.localizer.config
        with gui.add_folder("Object and sensor"):
            demo = config.object.path if config.object.path in DEMO_OBJECTS else OWN
            self.objects = gui.add_dropdown("Object", (*DEMO_OBJECTS, OWN), initial_value=demo)
            unit = config.object.units if demo == OWN else "auto"
            self.units = gui.add_dropdown(
                "Unit of own files",
                get_args(Units),
                initial_value=unit,
                visible=demo == OWN,
                hint="A STEP file states its own unit.",
            )
            self.upload = gui.add_upload_button(
                "Open your own mesh", hint="An STL, OBJ, PLY or STEP file.", icon="upload", **PLAIN
            )
            names = [name for name in registry().names("sensor") if name not in READ_FROM_PATHS]
            chosen = config.sensor.name if config.sensor.name in names else OWN
            self.sensors = gui.add_dropdown("Sensor", (*names, OWN), initial_value=chosen)
            self.sensor_path = gui.add_text(
                "Sensor file",
                str(config.sensor.options.get("path", "")),
                visible=chosen == OWN,
                hint="A sensor's .toml file or a calibration folder on this computer.",
            )
            self.use_sensor = gui.add_button("Use this sensor file", visible=chosen == OWN, **PLAIN)
            self.about = Paragraph(self.client)
        self.objects.on_update(self.notices.guard(self._choose_object))
        self.units.on_update(self.notices.guard(self._choose_units))
        self.upload.on_upload(self.notices.guard(self._upload_object))
        self.sensors.on_update(self.notices.guard(self._choose_sensor))
        self.use_sensor.on_click(self.notices.guard(self._read_sensor))

    def _choose_object(self) -> None:
        if self.objects.value != OWN:
            self.session.load_object(self.objects.value)
        elif self.session.mesh_file is not None:
            self.session.load_object(self.session.mesh_file, cast(Units, self.units.value))
        else:
            raise AppError('there is no mesh of your own yet; press "Open your own mesh"')
        self._show_object()

    def _choose_units(self) -> None:
        """Read the own mesh again, in another unit. If it cannot be used, its unit stays."""
        try:
            if self.session.choose_units(cast(Units, self.units.value)):
                self.objects.value = OWN
                self._show_object()
        finally:
            if self.session.is_own_object:
                self.units.value = self.session.localizer.config.object.units

    def _upload_object(self) -> None:
        self.units.visible = True
        self.session.upload_object(*take_upload(self.upload), cast(Units, self.units.value))
        self.objects.value = OWN
        self._show_object()

    def _choose_sensor(self) -> None:
        self.sensor_path.visible = self.use_sensor.visible = self.sensors.value == OWN
        if self.sensors.value != OWN:
            self.session.choose_sensor(self.sensors.value)
            self._show_object()

    def _read_sensor(self) -> None:
        self.session.choose_sensor(self.sensor_path.value)
        self._show_object()

    def _use_calibrated(self, made: MadeSensor) -> None:
        """Take the sensor that the visitor calibrated."""
        self.session.choose_sensor(str(made.folder))
        self.sensors.value = OWN
        self.sensor_path.value = str(made.folder)  # not shown, because it means nothing to people
        self._show_object()
        self.notices.notify(f"{made.folder.name} is the sensor now", "Go to the tab Locate. Its touches were removed.")

    def _show_object(self) -> None:
        """Draw the session's object and sensor, and begin without touches."""
        session, geometry = self.session, self.session.scene.geometry
        obj, size_mm = session.object, 1e3 * session.object.mesh.extents_m
        size = " x ".join(f"{length:.1f}" for length in size_mm)
        symmetry = "no symmetry" if obj.symmetry.is_trivial else f"symmetry {obj.symmetry}"
        sensor = session.localizer.config.sensor
        name = Path(str(sensor.options["path"])).name if "path" in sensor.options else sensor.name
        self.about.fill("**{}**: {} mm, {}. Sensor: {}", obj.name, size, symmetry, name)
        self.notices.tell_once(obj.notes)
        self.view.show_object(obj, geometry)
        gizmo = self.view.add_finger_gizmo(session.T_base_sensor, geometry)
        gizmo.on_update(self._follow_drag)
        self.depth.max = round(1e3 * geometry.max_depth_m, 2)
        self.depth.value = round(1e3 * session.press_depth_m, 2)
        self.prior_on.value = False
        self._show_touches()
        self._ask_press()

    # the press

    def _add_press_controls(self) -> None:
        gui = self.client.gui
        with gui.add_folder("Finger and touches"):
            Paragraph(self.client, "Drag the arrows and rings. The finger moves along its axis onto the object.")
            self.finger_on = gui.add_checkbox("Show the finger", initial_value=True)
            self.depth = gui.add_slider("Press (mm)", 0.05, 2.0, 0.01, 0.5)
            self.shape = gui.add_image(EMPTY, label="Contact shape")
            self.noise = gui.add_dropdown("Noise", get_args(NoiseLevel), initial_value="none")
            self.touches = Paragraph(self.client)
            self.chosen_touch = gui.add_dropdown("Touch", (NO_TOUCH,), visible=False)
            self.remove = gui.add_button("Remove this touch", visible=False, **PLAIN)
            self.clear = gui.add_button("Remove all touches", visible=False, **PLAIN)
        self.finger_on.on_update(self.notices.guard(lambda: self.view.show_finger(self.finger_on.value)))
        self.depth.on_update(self.notices.guard(self._ask_press))
        self.remove.on_click(self.notices.guard(self._remove_touch))
        self.clear.on_click(self.notices.guard(self._clear_touches))

    def _show_finger(self, shown: bool) -> None:
        """Show the finger with its arrows and rings, or hide them from a result."""
        self.finger_on.value = shown
        self.view.show_finger(shown)

    def _follow_drag(self, event: Any) -> None:
        self.notices.attempt(self._settle if event.phase == "end" else self._ask_press)

    def _ask_press(self) -> None:
        if self.view.finger_gizmo is not None:
            self.follower.ask((self.view.read_finger(self.session.scene.geometry), self._read_depth_m()))

    def _read_depth_m(self) -> float:
        """Return the press in metres. A typed number outside the slider's range is clipped, with a note."""
        asked = self.depth.value
        self.depth.value = min(max(asked, self.depth.min), self.depth.max)
        if asked != self.depth.value:
            limits = f"{self.depth.min:g} to {self.depth.max:g} mm"
            self.notices.notify(f"The press is {self.depth.value:g} mm", f"This sensor can be pressed {limits} deep.")
        return 1e-3 * float(self.depth.value)

    def _follow(self, asked: tuple[Pose, float]) -> None:
        self.notices.attempt(lambda: self._show_press(*asked))

    def _show_press(self, T_base_sensor: Pose, depth_m: float) -> None:
        press = self.session.press(T_base_sensor, depth_m)
        self.view.show_press(press)
        self.shape.image = paint_wide(press.shape, press.geometry)
        self.shape.label = "Contact shape" if press.touches else "Contact shape: the finger misses the object"

    def _settle(self) -> None:
        """Move the gizmo to the finger after a drag."""
        press = self.session.press(self.view.read_finger(self.session.scene.geometry), self._read_depth_m())
        if press.touches:
            self.view.move_finger_gizmo(press.T_base_sensor, self.session.scene.geometry)

    def _add_touch(self) -> None:
        geometry = self.session.scene.geometry
        self._show_finger(True)
        self.session.press(self.view.read_finger(geometry), self._read_depth_m())
        self.session.add_touch(self.noise.value)
        self._show_touches()

    def _remove_touch(self) -> None:
        self.session.remove_touch(self.chosen_touch.options.index(self.chosen_touch.value))
        self._show_touches()

    def _clear_touches(self) -> None:
        self.session.clear_touches()
        self._show_touches()

    def _show_touches(self) -> None:
        """List and draw the touches. A result stays until the next one, unless a touch was removed."""
        touches = self.session.touches
        names = [touch.name for touch in touches]
        self.locate.disabled = not touches
        self.touches.fill("Touches: {}" if touches else "No touch yet.", ", ".join(names))
        self.chosen_touch.options = list_numbered(names) or (NO_TOUCH,)
        self.chosen_touch.value = self.chosen_touch.options[-1]
        for handle in (self.chosen_touch, self.remove, self.clear):
            handle.visible = bool(touches)
        self.view.show_touches(touches)
        self.files.offer_again(self.session.touch_file is not None and not touches)
        if self.session.result is None:
            self._clear_result()

    # the result

    def _add_result_controls(self) -> None:
        gui = self.client.gui
        with gui.add_folder("Result"):
            self.status = Paragraph(self.client)
            self.verdict = Paragraph(self.client, visible=False)
            self.number = gui.add_slider("Pose", 1, 2, 1, 1, visible=False)
            self.shown_touch = gui.add_slider("Shown touch", 1, 2, 1, 1, visible=False)
            self.pose = Paragraph(self.client, visible=False)
            self.compared = gui.add_image(EMPTY, label="Left: observed. Right: predicted by this pose", visible=False)
            self.history = Paragraph(self.client, visible=False)
        self.number.on_update(self.notices.guard(self._show_pose))
        self.shown_touch.on_update(self.notices.guard(self._show_pose))

    def _locate(self) -> None:
        """Locate the object in the thread of this callback, so that the page can still be used."""
        self._read_prior()
        self.locate.disabled = True
        self._clear_result()
        touches = name_count(len(self.session.touches))
        self.overlay.begin(f"Locating from {touches}. The first time takes longer ...")
        try:
            found = self.session.locate(self._show_progress)
        finally:
            self.locate.disabled = not self.session.touches
            self.overlay.clear()
            if self.session.result is not None:
                self._show_result(self.session.result)
        if found is not self.session.result:
            self.notices.notify("The touches changed", "Locate again to use the present touches.")

    def _show_progress(self, task: str, share: float) -> None:
        """Show what the first run does."""
        self.overlay.show_progress(f"Building the model, once per object: {task}", share)

    def _show_result(self, found: Localization) -> None:
        self.overlay.show_result(found)
        seconds = f"{sum(found.seconds.values()):.2f}"
        self.status.fill("Located in {} s from {}", seconds, name_count(len(found.touches)))
        self.verdict.fill("", row="{}\n\n", rows=[(line,) for line in found.summary().splitlines()])
        self._write_history()
        for slider, count in ((self.number, len(found.hypotheses)), (self.shown_touch, len(found.touches))):
            slider.max, slider.value, slider.visible = max(count, 2), 1, count > 1
        for handle in (self.verdict, self.pose, self.compared, self.history):
            handle.visible = True
        self.next.disabled = self.export.disabled = False
        self.next.color = "gray" if found.verdict == "certain" else BRAND
        self._show_finger(found.verdict != "certain")  # a certain pose needs no further touch
        self._show_pose()

    def _write_history(self) -> None:
        rows = [
            (one.touches, one.verdict, _write_share(one.probability_within), one.explanations)
            for one in self.session.history
        ]
        tolerance = self.session.require_result().tolerance.describe()
        self.history.fill(
            "| touches | verdict | within {} | equal poses |\n|---|---|---|---|\n",
            tolerance,
            row="| {} | {} | {} | {} |\n",
            rows=rows,
        )

    def _show_pose(self) -> None:
        """Show the chosen hypothesis: its place in the view, its numbers, and the contact that it predicts."""
        found = self.session.result
        if found is None:
            return
        chosen = min(int(self.number.value), len(found.hypotheses)) - 1
        touch = min(int(self.shown_touch.value), len(found.touches)) - 1
        observed, predicted, geometry = self.session.predict(chosen, touch)
        self.compared.image = paint_beside(paint_wide(observed, geometry), paint_wide(predicted, geometry))
        self.pose.fill("{}", describe_pose(found, chosen))
        self.view.show_result(found, chosen)

    def _clear_result(self) -> None:
        self.view.clear_result()
        self._show_finger(True)
        self.overlay.show_hint(READY if self.session.touches else START)
        self.status.fill("")
        for handle in (self.verdict, self.number, self.shown_touch, self.pose, self.compared, self.history):
            handle.visible = False
        self.next.disabled = self.export.disabled = True

    def _suggest_next(self) -> None:
        """Draw the next touch, and move the finger there."""
        rated, geometry = self.session.suggest_next(), self.session.scene.geometry
        self.view.show_next(rated, geometry)
        share = rated.information / max(rated.information + rated.entropy, 1e-9)
        text = f"It should remove {format_percent(share)} of the doubt."
        if self.session.require_result().best.T_base_object is not None:
            self._show_finger(True)
            self.view.move_finger_gizmo(rated.approach.T_base_sensor, geometry)
            self._settle()
            self._ask_press()
            text += " The finger is there. Add this touch, and locate again."
        self.notices.notify("The next touch is green", text)

    # the prior

    def _add_prior_controls(self) -> None:
        gui = self.client.gui
        with gui.add_folder("Expected pose", expand_by_default=False):
            Paragraph(self.client, "Drag the yellow object roughly to where you expect it.")
            self.prior_on = gui.add_checkbox("Use an expected pose", initial_value=False)
            self.prior_mm = gui.add_number("Its error (mm)", PRIOR_MM, min=0.1, max=1000.0, step=0.1)
            self.prior_deg = gui.add_number("Its error (degrees)", PRIOR_DEG, min=0.1, max=180.0, step=0.1)
        self.prior_on.on_update(self.notices.guard(self._toggle_prior))

    def _toggle_prior(self) -> None:
        if self.prior_on.value:
            self.view.add_prior(np.eye(4))
        else:
            self.view.remove_prior()

    def _read_prior(self) -> None:
        """Take the expected pose from its gizmo."""
        gizmo = self.view.prior_gizmo
        T = None if gizmo is None or not self.prior_on.value else from_view(gizmo)
        self.session.set_prior(T, 1e-3 * self.prior_mm.value, float(np.radians(self.prior_deg.value)))

    # export

    def _export(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            exported = Path(folder) / "result"
            self.session.export(exported)
            content = Path(shutil.make_archive(str(exported), "zip", exported)).read_bytes()
        self.client.send_file_download(ARCHIVE, content, save_immediately=True)


def name_count(touches: int) -> str:
    """Return "1 touch" or "3 touches"."""
    return f"{touches} touch{'' if touches == 1 else 'es'}"


def describe_pose(found: Localization, number: int) -> str:
    """Return the probability of a hypothesis, how well it explains the touches, and its error.

    The error is the distance from the true pose, which virtual touches know, and the standard deviations of its place.
    """
    hypothesis = found.hypotheses[number]
    text = (
        f"Pose {number + 1} of {len(found.hypotheses)}: probability {format_percent(hypothesis.probability)}, "
        f"imprint IoU {format_percent(hypothesis.imprint_iou)}"
    )
    if (errors_m := found.measure_errors_m(found.object)) is not None:
        text += f", {format_mm(errors_m[number])} mm from the true pose"
    in_base = hypothesis.T_base_object is not None
    covariance = hypothesis.base_covariance if in_base else hypothesis.covariance
    if covariance is None:
        return text
    std_mm = 1e3 * np.sqrt(np.maximum(np.diag(covariance)[:3], 0.0))
    larger = choose_magnification(covariance)
    drawn = "" if larger == 1 else f", drawn {larger:.0f} times larger"
    x, y, z = (f"{value:.2g}" for value in std_mm)
    return f"{text}. Standard deviations of x, y, z: {x}, {y}, {z} mm (ellipsoid{drawn})."


def _write_share(share: float | None) -> str:
    return "-" if share is None else format_percent(share)
