"""The controls for touches from files and from a camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, get_args

from tactile_loc import DepthKind, DepthUnit, TactileLocError, Touch
from tactile_loc.commands import fold_line

from tactile_loc_app.page.markdown import Paragraph
from tactile_loc_app.page.notices import Notices
from tactile_loc_app.page.pictures import EMPTY, paint_beside, paint_photo, paint_wide
from tactile_loc_app.session import Session
from tactile_loc_app.uploads import LARGEST_MB, take_upload

if TYPE_CHECKING:
    from viser import ClientHandle

IN_FILE = "as in the file"


class FileControls:
    """Adds the touches in uploaded files or in frames of a camera to a session. `show_touches` draws them."""

    def __init__(
        self, client: ClientHandle, session: Session, notices: Notices, show_touches: Callable[[], None]
    ) -> None:
        self.client, self.session, self._show_touches = client, session, show_touches
        self._add_files(notices)
        self._add_camera(notices)

    def _add_files(self, notices: Notices) -> None:
        gui = self.client.gui
        with gui.add_folder("Touches from files", expand_by_default=False):
            Paragraph(
                self.client,
                "A contact shape (npz, npy, 16-bit png), or a photo of a calibrated sensor. For several touches with "
                "sensor poses, upload a zip archive of their list (touches.toml) and its files. Or upload the files "
                f"first, and then the list. At most {LARGEST_MB} MB each.",
            )
            self.unit = gui.add_dropdown("Unit of depths", (IN_FILE, *get_args(DepthUnit)), initial_value=IN_FILE)
            self.kind = gui.add_dropdown("Depths are", (IN_FILE, *get_args(DepthKind)), initial_value=IN_FILE)
            self.file = gui.add_upload_button("Upload a touch or a list")
            self.again = gui.add_button("Read the uploaded file again", visible=False)
        self.file.on_upload(notices.guard(lambda: self._read(self.session.read_touch_file, *take_upload(self.file))))
        self.again.on_click(notices.guard(lambda: self._read(self.session.read_touches_again)))

    def _read(self, read: Callable[..., tuple[Touch, ...]], *file: str | bytes) -> None:
        """Read touches. If this fails, the file is kept, so that it can be read again with other settings."""
        unit, kind = (None if chosen.value == IN_FILE else chosen.value for chosen in (self.unit, self.kind))
        try:
            added = read(*file, unit, kind)
        except TactileLocError:
            self.offer_again(self.session.touch_file is not None)
            raise
        self._show(added[-1])

    def offer_again(self, offers: bool) -> None:
        """Show or hide the button that reads the latest uploaded file again."""
        self.again.visible = offers

    def _add_camera(self, notices: Notices) -> None:
        gui = self.client.gui
        with gui.add_folder("Touches from a camera", expand_by_default=False):
            Paragraph(
                self.client,
                "The camera of a calibrated sensor, at the computer that runs this page: its number, such as 0, or a "
                "device. The path of a video or of a folder that receives images works, too.",
            )
            self.camera = gui.add_text("Camera", "0")
            self.take = gui.add_button("Take a touch from the camera")
            self.taken = gui.add_image(EMPTY, label="", visible=False)
        self.take.on_click(notices.guard(self._take))

    def _take(self) -> None:
        self.take.disabled = True
        try:
            touch = self.session.take_camera_touch(self.camera.value)
        finally:
            self.take.disabled = False
        self._show(touch)

    def _show(self, touch: Touch) -> None:
        """Show a touch from a photo beside what the sensor reads in it."""
        self._show_touches()
        self.taken.visible = touch.image is not None
        if touch.image is not None:
            shape = paint_wide(touch.contact_shape, touch.geometry)
            self.taken.image = paint_beside(paint_photo(touch.image, shape.shape[:2]), shape)
            self.taken.label = f"{fold_line(touch.name)}. Left: the photo. Right: its contact shape"
