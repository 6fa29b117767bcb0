"""Results and geometry as messages that other tools draw: images, boxes, calibration, transforms."""

from collections.abc import Iterator

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from scipy.spatial.transform import Rotation

from rangecam.config import Config
from rangecam.geometry import Lens, pixel_pitch, position, rotation
from rangecam.io.messages import OPTICAL, Json, Topic, image_message, timestamp
from rangecam.types import Decision, Floats, Frame, Track, Tracks, TrackStatus

VEHICLE, CAMERA = "vehicle", "camera"
"""Frames of reference: x forward, y left, z up."""

_OPTICAL_IN_CAMERA = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
_SEGMENT = Color(r=0.6, g=0.6, b=0.6, a=0.3)
_TRACK = {
    TrackStatus.TENTATIVE: Color(r=0.3, g=0.6, b=1.0, a=0.3),
    TrackStatus.CONFIRMED: Color(r=0.1, g=0.8, b=0.3, a=0.5),
    TrackStatus.COASTING: Color(r=1.0, g=0.7, b=0.0, a=0.4),
}
_BRAKE = Color(r=1.0, g=0.1, b=0.1, a=0.6)
_SMALLEST_BOX_M = 0.02


def geometry_messages(config: Config, shape: tuple[int, int], time_s: float) -> Iterator[Topic]:
    """Yield the calibration of the camera for (H, W) images and its pose, once a recording."""
    yield "/camera/calibration", _calibration(config.camera.lens, shape, time_s)
    yield "/tf", _transform(VEHICLE, CAMERA, position(config.mounting), rotation(config.mounting), time_s)
    yield "/tf", _transform(CAMERA, OPTICAL, np.zeros(3), _OPTICAL_IN_CAMERA, time_s)


def _calibration(lens: Lens, shape: tuple[int, int], time_s: float) -> CameraCalibration:
    """Return the pinhole matrices of a perspective lens and its distortion.

    An equiangular lens has none: its distortion model is named so, with the angles from pixel to pixel (rad,
    across columns and rows) as parameters; nor has a lens whose rays a table gives, which is named "table".
    """
    height, width = shape
    pitch_h, pitch_v = pixel_pitch(lens, shape)
    if lens.table or lens.projection == "equiangular":
        model, parameters, K, P = "table" if lens.table else "equiangular", [pitch_h, pitch_v], [], []
    else:
        fx, fy = 1 / pitch_h, 1 / pitch_v
        cx, cy = (width - 1) / 2 + width * lens.axis_right, (height - 1) / 2 + height * lens.axis_down
        model, parameters = "plumb_bob", [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
        K, P = [fx, 0, cx, 0, fy, cy, 0, 0, 1], [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]
    return CameraCalibration(
        timestamp=timestamp(time_s),
        frame_id=OPTICAL,
        width=width,
        height=height,
        distortion_model=model,
        D=parameters,
        K=K,
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=P,
    )


def _transform(parent: str, child: str, origin_m: Floats, matrix: Floats, time_s: float) -> FrameTransform:
    """Return the pose of a frame of reference in its parent; `matrix` turns the child's axes into the parent's."""
    x, y, z, w = Rotation.from_matrix(np.array(matrix)).as_quat()
    return FrameTransform(
        timestamp=timestamp(time_s),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=_vector(origin_m),
        rotation=Quaternion(x=x, y=y, z=z, w=w),
    )


def _vector(values: Floats) -> Vector3:
    x, y, z = (float(value) for value in values)
    return Vector3(x=x, y=y, z=z)


def result_messages(frame: Frame) -> Iterator[Topic]:
    """Yield what perception made of a frame: images, boxes to draw, tracks and decision with all their numbers."""
    image = frame.image
    for name, plane in (("range", image.range_m), ("sigma", image.sigma_m), ("amplitude", image.amplitude)):
        yield f"/image/{name}", image_message(plane, image.time_s)
    yield "/image/why", image_message(image.why, image.time_s)
    yield "/objects", _objects(frame)
    yield "/tracks", _tracks(frame.tracks)
    yield "/decision", _decision(frame.decision)


def _objects(frame: Frame) -> SceneUpdate:
    """Return boxes of segments and tracks, the tracks with their number, class and way within the next second."""
    boxes = [_box(s.position_m, s.size_m, _SEGMENT) for s in frame.segments]
    tracks = list(frame.tracks)
    decisive = frame.decision.track_id if frame.decision.brake else 0
    colors = [_BRAKE if track.track_id == decisive else _TRACK[track.status] for track in tracks]
    common = {"timestamp": timestamp(frame.image.time_s), "frame_id": VEHICLE}
    return SceneUpdate(
        entities=[
            SceneEntity(id="segments", cubes=boxes, **common),
            SceneEntity(
                id="tracks",
                cubes=[_box(t.position_m, t.size_m, color) for t, color in zip(tracks, colors, strict=True)],
                lines=[_way(t, color) for t, color in zip(tracks, colors, strict=True)],
                texts=[_label(t, color) for t, color in zip(tracks, colors, strict=True)],
                **common,
            ),
        ]
    )


def _pose(centre_m: Floats) -> Pose:
    return Pose(position=_vector(centre_m), orientation=Quaternion(w=1.0))


def _box(centre_m: Floats, size_m: Floats, color: Color) -> CubePrimitive:
    return CubePrimitive(pose=_pose(centre_m), size=_vector(np.maximum(size_m, _SMALLEST_BOX_M)), color=color)


def _way(track: Track, color: Color) -> LinePrimitive:
    ends = [track.position_m, track.position_m + track.velocity_mps]
    points = [Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in ends]
    return LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=_pose(np.zeros(3)),
        thickness=2.0,
        scale_invariant=True,
        points=points,
        color=color,
    )


def _label(track: Track, color: Color) -> TextPrimitive:
    top = track.position_m + np.array([0.0, 0.0, track.size_m[2] / 2 + 0.1])
    text = f"#{track.track_id} {track.class_name}"
    return TextPrimitive(pose=_pose(top), billboard=True, font_size=14, scale_invariant=True, color=color, text=text)


def _tracks(tracks: Tracks) -> Json:
    rows = [
        {
            "track_id": track.track_id,
            "status": track.status.name.lower(),
            "state": track.state,
            "covariance": track.covariance,
            "age": track.age,
            "hits": track.hits,
            "misses": track.misses,
            "size_m": track.size_m,
            "near_offset_m": track.near_offset_m,
            "n_pixels": track.n_pixels,
            "segment": track.segment,
            "class_probability": track.class_probability,
            "nis": nis,
        }
        for track, nis in zip(tracks, tracks.nis, strict=True)
    ]
    return Json("rangecam.Tracks", {"time_s": tracks.time_s, "next_id": tracks.next_id, "tracks": rows})


def _decision(decision: Decision) -> Json:
    values = {key: value for key, value in vars(decision).items() if key != "collisions"}
    return Json("rangecam.Decision", {**values, "collisions": vars(decision.collisions)})
