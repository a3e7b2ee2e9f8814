"""The lens that the fields of a foreign document state: used, or refused by the key's name.

Every key that looks like one of a lens is either read here or stops the import: a lens that is
dropped without a word bends all that follows.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera_models import MODELS, Pinhole

# Keys are compared in lower case, without separators.
MODEL_KEYS = (
    "cameramodel", "distortionmodel", "lensmodel", "modeltype", "distortiontype", "lenstype",
    "cameratype", "projectiontype", "projectionmodel", "projectionmodeltype", "projection",
    "intrinsictype", "modelname", "type", "model", "distortion", "lens",
)  # fmt: skip
# Under these keys, a name that is no lens may be that of a device or of something else.
_MAY_BE_DEVICE = frozenset({"model", "modelname", "type", "lens", "projection"})
FISHEYE_KEYS = ("isfisheye", "fisheyemodel", "fisheye", "usefisheye")
LIST_KEYS = (
    "distortion", "distortioncoefficients", "distortioncoeffs", "distortioncoeff",
    "distortioncoefficient", "distcoeffs", "distcoeff", "distcoefs", "distcoef",
    "distcoefficients", "distortionparameters", "distortionparams", "distortionparam",
    "distparams", "distortionvector", "distortionvec", "cameradistortion", "lensdistortion",
    "acameralensdistortion",
    "distortions", "distcoeffsmat", "coefficients", "coeffs", "coeff", "kc", "dist", "d",
)  # fmt: skip
# LENS_DISTORTION of Android's Camera2 is OpenCV's model in another order. Its names, and keys that
# show beside it that a document is Android's, where it is spelled lens_distortion.
_ANDROID_NAMES = ("lensDistortion", "LENS_DISTORTION", "ACAMERA_LENS_DISTORTION")
_ANDROID_KEYS = re.compile(
    r"lens(intrinsiccalibration|pose(rotation|translation|reference)|facing)"
)
_ANDROID_ORDER = "k1 k2 k3 p1 p2"
_RADIAL, _TANGENTIAL = (
    ("radialdistortion", "radial", "radialcoefficients", "radialdistortioncoefficients"),
    ("tangentialdistortion", "tangential", "tangentialcoefficients"),
)
NAMED_KEYS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# `rs2_distortion` of librealsense, by number.
_LIBREALSENSE = (
    "none", "modified brown conrady", "inverse brown conrady", "ftheta", "brown conrady",
    "kannala brandt4",
)  # fmt: skip
# Keys that look like a lens; those of depth sensors and of ranges do not count.
_LENSLIKE = re.compile(
    r"dist(?!ance|ribut|urb|inct|rict)|fisheye|^k\d+$|^p[1-9]$|model|^xi$|^(alpha|beta|lambda)$"
    r"|lens|radial|tangential|^coef|coeffs?$|poly(?!gon)|^s[1-4]$|^tau[xy]$|mirror|affine|skew"
    r"|ftheta|latlong|equirect|panoram|^cod[xy]$"
)
_NO_LENS = re.compile(
    r"(min|max|near|far|focus|working|threshold|thr|th)dist|dist(min|max|th|thresh|threshold)$"
    r"|undist|^numradial|^estimate|intrinsiccoeff|lens(pos|id|name|serial|mount|focus|spec|shading|facing|intrinsiccalib|info|aperture|focal)"
    r"|model(id|path|file|number|index|nr|year)|(cad|mesh|object|depth|noise|imu|world)model"
)
# Names that mention one of these are lens models other than OpenCV's, not names of devices.
_FOREIGN = re.compile(
    "inverse|modified|fisheye|equi|kannala|theta|omni|eucm|unified|^ds$|doublesphere|spher|division"
    r"|fov|mei$|scaramuzza|thinprism|cataptric|ortho|vr180|radial\d"
)
_NOTHING = ("", "none", "null", "false", "no", "0", "identity")


def plain_key(key: object) -> str:
    """A key in lower case, without separators."""
    return re.sub("[^a-z0-9]", "", str(key).lower())


class FiledLens:
    """Lens model and coefficients of a mapping, with the keys that they are from.

    Attributes:
        model: as in `Camera`.
        coefficients: in the model's order; empty for a pinhole.
        keys: names of the keys that were read.
        sources: these keys, with the order of the coefficients where it is not OpenCV's.

    Args:
        data: keys as filed -> values: those of the camera, and of what encloses it.
        number: converts a value, or raises.

    Raises:
        ToolkitError: a lens that is not supported, incomplete or contradictory; the key is named.
    """

    def __init__(self, data: Mapping[str, Any], number: Callable[[Any, str], float]) -> None:
        self.data, self.number = data, number
        self.plain: dict[str, str] = {}
        for key in data:
            self.plain.setdefault(plain_key(key), key)
        self.keys: list[str] = []
        stated = self._listed() or self._split()
        named = self._named()
        self.model = model_of_fields(
            data, has_coefficients=any(stated or ()) or any(named.values())
        )
        if stated is not None:
            self._refuse_second(stated, named)
            self.coefficients = listed_coefficients(stated, self.model)
            if self.model == "opencv" and not any(stated):
                self.coefficients = ()
        else:
            self.coefficients = self._from_names(named)
        self._refuse_rest()
        self.sources = [
            f"{k}, in Android's order {_ANDROID_ORDER}" if self._is_android(k) else k
            for k in self.keys
        ]

    def _listed(self) -> list[float] | None:
        found: dict[str, list[float]] = {}
        for plain in LIST_KEYS:
            key = self.plain.get(plain)
            if key is None or (values := self._numbers(key)) is None:
                continue
            if isinstance(self.data[key], int | float) and not isinstance(self.data[key], bool):
                if values[0] == 0:
                    continue
                raise ToolkitError("must be a list of numbers", field=key, value=self.data[key])
            if self._is_android(key):
                k1, k2, k3, p1, p2 = values
                values = [k1, k2, p1, p2, k3]
            found[key] = values
        self.keys += found
        return self._only(found)

    def _is_android(self, key: str) -> bool:
        """Whether a key is Camera2's list of five coefficients."""
        if not plain_key(key).endswith("lensdistortion"):
            return False
        values = self.data[key]
        if not isinstance(values, list) or len(values) != 5:
            return False
        return key in _ANDROID_NAMES or any(_ANDROID_KEYS.search(plain) for plain in self.plain)

    def _split(self) -> list[float] | None:
        """Radial and tangential coefficients under two keys."""
        parts = []
        for names in (_RADIAL, _TANGENTIAL):
            key = next((self.plain[n] for n in names if n in self.plain), None)
            values = None if key is None else self._numbers(key)
            self.keys += [key] if key is not None and values is not None else []
            parts.append(values)
        radial, tangential = parts
        if radial is None and tangential is None:
            return None
        radial, tangential = radial or [0.0, 0.0], tangential or [0.0, 0.0]
        if len(tangential) != 2 or len(radial) not in (2, 3, 6):
            raise ToolkitError(
                "needs 2, 3 or 6 radial and 2 tangential coefficients",
                field=self.keys[-1], value=[len(radial), len(tangential)],
            )  # fmt: skip
        return [*radial[:2], *tangential, *radial[2:]]

    def _named(self) -> dict[str, float]:
        found = {}
        for name in NAMED_KEYS:
            key = self.plain.get(name)
            if key is not None and isinstance(self.data[key], list | Mapping):
                continue  # K1 of a stereo pair is a matrix
            if key is not None and self.data[key] is not None:
                found[name] = self.number(self.data[key], key)
                self.keys.append(key)
        return found

    def _numbers(self, key: str) -> list[float] | None:
        """Numbers of a value; None of a name, a section or nothing."""
        value = self.data[key]
        if isinstance(value, Mapping):
            inner = {plain_key(k): v for k, v in value.items()}
            if "data" not in inner:
                return None
            value = inner["data"]
        if value is None or isinstance(value, str | bool):
            return None
        flat: list[float] = []
        _flatten(value, flat, key, self.number)
        return flat

    def _only(self, found: Mapping[str, list[float]]) -> list[float] | None:
        """The coefficients of several keys, which must agree."""
        filled = {k: v for k, v in found.items() if any(v)} or found
        if not filled:
            return None
        first = next(iter(filled))
        for key, values in filled.items():
            if values != filled[first]:
                raise ToolkitError(
                    f"{first} and {key} state different distortions",
                    field=key, value=values, hint="remove one",
                )  # fmt: skip
        return list(filled[first])

    def _refuse_second(self, stated: Sequence[float], named: Mapping[str, float]) -> None:
        order = re.findall(r"\w+", MODELS[self.model].order)
        same = dict(zip(order, [*stated, *[0.0] * 8], strict=False))
        for key, value in named.items():
            if value and value != same.get(key):
                raise ToolkitError(
                    f"contradicts {self.keys[0]}", field=key, value=value, hint="remove one"
                )

    def _from_names(self, named: Mapping[str, float]) -> tuple[float, ...]:
        order = re.findall(r"\w+", MODELS[self.model].order)
        k = tuple(named.get(key, 0.0) for key in order)
        if extra := next((x for x in named if x not in order and named[x]), None):
            raise ToolkitError(
                f"is no coefficient of the {self.model} lens ({MODELS[self.model].order})",
                field=extra, value=named[extra],
            )  # fmt: skip
        if self.model != "opencv":
            if "k1" not in named:  # a pinhole is OpenCV's model without coefficients
                raise ToolkitError(
                    f"the coefficients of the {self.model} lens are missing",
                    field="k1",
                    hint=f"needed: {MODELS[self.model].order}, or `distortion` with all of them",
                )
            return k
        if not any(k[5:]):
            return k[:5] if any(k) else ()
        stated = " ".join(str(v) for v in self.data.values() if isinstance(v, str))
        if not ("k5" in named or "k6" in named or re.search("(?i)full|rational", stated)):
            raise ToolkitError(
                "of the rational model, or of a longer polynomial, as nerfstudio has it?",
                field="k4",
                value=named["k4"],
                hint="state the model: FULL_OPENCV or OPENCV_FISHEYE; others are not supported",
            )
        return k

    def _refuse_rest(self) -> None:
        """Refuse what looks like a lens and was not read.

        Raises:
            ToolkitError: such a key has a value that says something.
        """
        for key, value in self.data.items():
            plain = plain_key(key)
            if (
                key in self.keys
                or (plain in (*MODEL_KEYS, *FISHEYE_KEYS) and not isinstance(value, Mapping))
                or _says_nothing(value)
            ):
                continue
            if isinstance(value, Mapping) and states_lens(value):
                if self.keys:
                    continue  # that of another camera
            elif not _LENSLIKE.search(plain) or _NO_LENS.search(plain):
                continue
            if isinstance(value, bool) and any(self.coefficients):
                continue  # "distorted: true"
            is_text = isinstance(value, str) and not (
                plain in LIST_KEYS and re.search(r"\d", value)
            )
            if is_text and not _FOREIGN.search(plain_key(value)):
                continue  # a name of something else
            raise ToolkitError(
                "looks like a part of the lens, and is not understood",
                field=key,
                value=value if not isinstance(value, Mapping) else sorted(map(str, value))[:6],
                hint="give --intrinsics fx,fy,cx,cy and --distortion, or remove it from the file",
            )


def states_lens(section: Mapping[str, Any]) -> bool:
    """Whether a section has coefficients under names that are known."""
    for key, value in section.items():
        plain = plain_key(key)
        if isinstance(value, Mapping):
            if states_lens(value):
                return True
        elif plain in NAMED_KEYS or (
            plain in (*LIST_KEYS, *_RADIAL, *_TANGENTIAL) and isinstance(value, list)
        ):
            return True
    return False


def _says_nothing(value: Any) -> bool:
    if value is None or value is False:
        return True
    if isinstance(value, str):
        return value.strip().lower() in _NOTHING
    if isinstance(value, Mapping):
        return all(
            _says_nothing(v)
            for k, v in value.items()
            if plain_key(k) not in ("rows", "cols", "dt", "typeid", "size")
        )
    if isinstance(value, list | tuple):
        return all(_says_nothing(v) for v in value)
    return isinstance(value, int | float) and value == 0 and not isinstance(value, bool)


def _flatten(value: Any, into: list[float], key: str, number: Callable[[Any, str], float]) -> None:
    if isinstance(value, list | tuple):
        for item in value:
            _flatten(item, into, key, number)
    else:
        into.append(number(value, key))


def listed_coefficients(values: Sequence[float], model: str) -> tuple[float, ...]:
    """Coefficients of a list in the model's order, without zeros that are too many.

    Raises:
        ToolkitError: too many or too few coefficients.
    """
    k = list(values)
    counts = sorted(set(MODELS[model].counts) - {0})
    if any(k) and len(k) < counts[0]:
        raise ToolkitError(
            f"needs {', '.join(map(str, counts[:-1]))} or {counts[-1]} coefficients"
            if len(counts) > 1 else f"needs {counts[0]} coefficients",
            field="distortion", value=k, hint=f"{MODELS[model].order}; append zeros",
        )  # fmt: skip
    count = max((n for n in MODELS[model].counts if n <= len(k)), default=len(k))
    if any(k[count:]):
        raise ToolkitError("too many distortion coefficients", value=len(k))
    return tuple(k[:count])


def model_of_fields(data: Mapping[str, Any], *, has_coefficients: bool) -> str:
    """The model in `MODELS` that a foreign document states; "opencv" if it states none.

    Args:
        data: its keys, such as `camera_model`, `distortion_model`, `is_fisheye`.
        has_coefficients: whether a distortion coefficient differs from 0.

    Raises:
        ToolkitError: the stated model is none of `MODELS`.
    """
    found: set[str] = set()
    for key, value in data.items():
        plain_name = plain_key(key)
        if plain_name in FISHEYE_KEYS:
            if str(value).lower() in ("true", "1", "1.0"):
                found.add("fisheye")
            continue
        if plain_name not in MODEL_KEYS:
            continue
        if plain_name != "distortion" and has_coefficients:
            value = _decoded(key, value, data)
        if not isinstance(value, str):
            continue
        text = value.lower().strip()
        plain = plain_key(re.sub(r"^(distortion|rs2?_?distortion)[._]", "", text))
        plain = plain.removeprefix("calibrationlensdistortionmodel")
        known = next((name for name, kind in MODELS.items() if plain in kind.named), None)
        if known is not None:
            found.add(known)
        elif text not in _NOTHING and not _is_harmless(plain_name, plain, has_coefficients):
            raise ToolkitError(
                "this distortion model is not supported",
                field=key,
                value=value,
                hint="supported are OpenCV's radial-tangential, rational and fisheye models; "
                "undistort the images first",
            )
    # Kalibr states "pinhole" and "equidistant" of one lens.
    return next((name for name in found if name != "opencv"), "opencv")


def _decoded(key: str, value: Any, data: Mapping[str, Any]) -> Any:
    """The name of a model that is stated by a number.

    Raises:
        ToolkitError: the number is not understood.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or value == 0:
        return value
    plain = plain_key(key)
    if plain == "model" and "coeffs" in map(plain_key, data) and 0 < value < len(_LIBREALSENSE):
        return _LIBREALSENSE[int(value)]
    if plain in _MAY_BE_DEVICE:
        return value
    raise ToolkitError(
        "a lens model that is stated by a number is not understood", field=key, value=value,
        hint="write its name, such as opencv or fisheye",
    )  # fmt: skip


def _is_harmless(key: str, name: str, has_coefficients: bool) -> bool:
    """Whether a name that is no known model is that of a pinhole, or may be that of a device."""
    if name in Pinhole.named:
        return True
    if not has_coefficients and "brown" in name:  # those of librealsense, without distortion
        return True
    may_be_device = key in _MAY_BE_DEVICE or (key == "cameramodel" and not has_coefficients)
    return may_be_device and not _FOREIGN.search(name)
