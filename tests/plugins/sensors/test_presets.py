import numpy as np
import pytest

from tactile_loc.plugin import SensorError, TouchError, registry
from tactile_loc.plugins.sensors.presets import CurvedDigit, Digit, GelSightMini, GelSightR15, GelSlim, Preset

MM = 1e-3
NAMES = {
    "gelslim": GelSlim,
    "gelsight-mini": GelSightMini,
    "gelsight-r15": GelSightR15,
    "digit": Digit,
    "digit-curved": CurvedDigit,
}
ALL = pytest.mark.parametrize("sensor", [kind() for kind in NAMES.values()], ids=list(NAMES))


def field_mm(sensor: Preset) -> tuple[float, float]:
    x0, x1, y0, y1 = sensor.geometry.rectangle
    return (x1 - x0) / MM, (y1 - y0) / MM


def test_gelslim_has_the_numbers_of_the_paper() -> None:
    native = GelSlim(GelSlim.Options(image_size_px=(470, 470))).geometry
    assert (native.camera, native.shape) == ("pinhole", (470, 470))
    assert (native.fx, native.fy, native.cx, native.cy) == (291.5, 289.0, 235.0, 235.0)
    assert (native.standoff_m, native.max_depth_m) == (25 * MM, 2 * MM)
    small = GelSlim().geometry
    assert small.shape == (200, 200)
    assert (small.fx, small.cx) == pytest.approx((291.5 * 200 / 470, 100.0))
    assert field_mm(GelSlim()) == pytest.approx((470 / 291.5 * 25, 470 / 289 * 25))


def test_presets_have_their_nominal_fields_of_view() -> None:
    assert GelSightMini().geometry.shape == (240, 320)
    assert field_mm(GelSightMini()) == pytest.approx((320 * 0.0634, 240 * 0.0634))
    assert GelSightR15().geometry.shape == Digit().geometry.shape == (320, 240)
    assert field_mm(GelSightR15()) == pytest.approx((240 * 0.0877, 320 * 0.0877))
    assert field_mm(Digit()) == pytest.approx((15.1, 20.2), abs=0.05)
    assert GelSightMini().geometry.max_depth_m == Digit().geometry.max_depth_m == 1 * MM


def test_the_curved_digit_is_a_cap_of_a_sphere() -> None:
    geometry = CurvedDigit(CurvedDigit.Options(radius_mm=30.0)).geometry
    points = geometry.backproject(geometry.standoff_m + geometry.relief_m)
    centre = np.array([0.0, 0.0, geometry.standoff_m - 30 * MM])
    assert np.linalg.norm(points - centre, axis=-1) == pytest.approx(30 * MM, abs=1e-9)
    assert geometry.relief_m.max() == pytest.approx(0.0, abs=1e-7)
    nominal = CurvedDigit().geometry.relief_m
    assert nominal.min() == pytest.approx(-2.35 * MM, abs=0.05 * MM)


@ALL
def test_options_change_only_the_values_that_they_name(sensor: Preset) -> None:
    kind = type(sensor)
    resized = kind(kind.Options(image_size_px=(64, 48), max_depth_mm=0.5))
    assert resized.geometry.shape == (48, 64)
    assert resized.geometry.max_depth_m == 0.5 * MM
    assert resized.geometry.standoff_m == sensor.geometry.standoff_m
    assert field_mm(resized) == pytest.approx(field_mm(sensor))
    assert resized.describe() != sensor.describe()


@ALL
@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"image_size_px": (0, 10)}, "width_px"),
        ({"image_size_px": (10, -1)}, "height_px"),
        ({"max_depth_mm": -1.0}, "max_depth_m"),
    ],
)
def test_impossible_options_are_refused_at_once(sensor: Preset, options: dict, name: str) -> None:
    kind = type(sensor)
    with pytest.raises(SensorError, match=name):
        kind(kind.Options(**options))


@ALL
def test_images_are_refused(sensor: Preset) -> None:
    for shape in ((*sensor.geometry.shape, 3), sensor.geometry.shape):
        with pytest.raises(TouchError, match="`sensor`"):
            sensor.contact_shape(np.zeros(shape, np.uint8))


THICKNESSES_MM = {"gelslim": 4.0, "gelsight-mini": 4.25, "gelsight-r15": 4.0, "digit": 4.6, "digit-curved": 4.6}


@pytest.mark.parametrize("name", NAMES)
def test_a_gel_is_rigid_unless_it_is_a_layer_of_the_usual_or_a_given_thickness(name: str) -> None:
    def create(**options: object) -> Preset:
        return registry().create("sensor", name, options)

    assert isinstance(create(), NAMES[name])
    assert not create().geometry.gel.is_elastic
    assert not create(poisson=0.4).geometry.gel.is_elastic
    assert create(gel="layer").geometry.gel.thickness_m == pytest.approx(THICKNESSES_MM[name] * MM)
    assert create(gel_thickness_mm=2.5).geometry.gel.thickness_m == pytest.approx(2.5 * MM)
    with pytest.raises(SensorError):
        create(gel_coating_mm=0.3)
