"""Geometries of messages: WKT in the frame of the header or in WGS84, the same in all syntaxes, ignored when sent."""

from __future__ import annotations

import math
from itertools import chain
from typing import Any

import pytest
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.body import parse_body
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.geometry import Geometry, geometry_of
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.vocab import geo, rdf, sf
from tests.ontology.test_serialize import canonical, read

FRAMES = "http://robot.example/frames"
URL = "http://robot.example/topics/place"
HEADER = {"frame_id": "/base link", "stamp": {"sec": 12, "nanosec": 500}}
UPRIGHT = {"w": 1.0}
STAMP = "12.0000005"
LIBRARY = TypeLibrary(ros_version=2)


def schema_of(name: str) -> MessageSchema:
    schema = LIBRARY.find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def geometry(name: str, **value: Any) -> Geometry | None:
    schema = schema_of(name)
    return geometry_of(schema, lowerer(schema).from_json(value, defaults=True))


def wkt(name: str, **value: Any) -> str | None:
    found = geometry(name, **value)
    return None if found is None else found.wkt(FRAMES)


def in_frame(text: str) -> str:
    return f"<{FRAMES}#base%20link> {text}"


def test_stamped_places_are_in_the_frame_of_their_header_at_its_time() -> None:
    point = {"x": 1.5, "y": -2, "z": 1e-7}
    expected = in_frame(f"POINT ZM(1.5 -2.0 1e-07 {STAMP})")
    assert wkt("geometry_msgs/msg/PointStamped", header=HEADER, point=point) == expected
    assert wkt("geometry_msgs/msg/PoseStamped", header=HEADER, pose={"position": point}) == expected
    pose = {"pose": {"position": point}}
    assert wkt("geometry_msgs/msg/PoseWithCovarianceStamped", header=HEADER, pose=pose) == expected
    assert wkt("nav_msgs/msg/Odometry", header=HEADER, pose=pose) == expected
    assert wkt("geometry_msgs/msg/TransformStamped", header=HEADER, transform={"translation": point}) == expected


def test_without_a_stamp_there_is_no_time_and_without_a_frame_no_place() -> None:
    assert wkt("geometry_msgs/msg/PointStamped", header={"frame_id": "map"}) == f"<{FRAMES}#map> POINT Z(0.0 0.0 0.0)"
    assert wkt("geometry_msgs/msg/PointStamped") is None
    assert wkt("geometry_msgs/msg/Pose") is None
    assert wkt("geometry_msgs/msg/TwistStamped", header=HEADER) is None
    assert wkt("geometry_msgs/msg/PointStamped", header=HEADER, point={"x": "NaN"}) is None


def test_paths_polygons_and_maps_are_lines_and_rings() -> None:
    poses = [{"pose": {"position": {"x": x}}} for x in (0, 1)]
    line = in_frame(f"LINESTRING ZM(0.0 0.0 0.0 {STAMP},1.0 0.0 0.0 {STAMP})")
    assert wkt("nav_msgs/msg/Path", header=HEADER, poses=poses) == line
    assert wkt("nav_msgs/msg/Path", header=HEADER, poses=poses[:1]) is None
    assert wkt("nav_msgs/msg/Path", header=HEADER, poses=poses * 501) is None
    corners = [{"x": 0, "y": 0}, {"x": 1, "y": 0}, {"x": 1, "y": 1}]
    ring = ",".join(f"{x} {y} 0.0 {STAMP}" for x, y in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 0.0)))
    assert wkt("geometry_msgs/msg/PolygonStamped", header=HEADER, polygon={"points": corners}) == in_frame(
        f"POLYGON ZM(({ring}))"
    )
    turned = {"position": {"x": 10, "y": 20, "z": 1}, "orientation": {"z": math.sqrt(0.5), "w": math.sqrt(0.5)}}
    info = {"width": 4, "height": 2, "resolution": 0.5, "origin": turned}
    found = geometry("nav_msgs/msg/OccupancyGrid", header=HEADER, info=info)
    assert found is not None
    corners_of_map = [(10, 20, 1), (10, 22, 1), (9, 22, 1), (9, 20, 1), (10, 20, 1)]
    assert [*chain(*found.points)] == pytest.approx([*chain(*corners_of_map)])


def test_a_fix_is_in_wgs84_longitude_first() -> None:
    fix = {"latitude": 52.5, "longitude": 13.25, "altitude": "NaN"}
    crs = "<http://www.opengis.net/def/crs/OGC/1.3/CRS84>"
    assert wkt("sensor_msgs/msg/NavSatFix", header=HEADER, **fix) == f"{crs} POINT(13.25 52.5)"
    assert wkt("sensor_msgs/msg/NavSatFix", header=HEADER, status={"status": -1}, **fix) is None


@pytest.mark.parametrize("syntax", Syntax)
def test_every_syntax_has_the_geometry_which_is_ignored_when_it_is_sent(syntax: Syntax) -> None:
    schema = schema_of("geometry_msgs/msg/PoseStamped")
    message = lowerer(schema).from_json({"header": HEADER, "pose": {"orientation": UPRIGHT}}, defaults=True)
    lifted = LiftedMessage("#message", lifter(schema), message, frames=FRAMES)
    document = Document(URL, (), (lifted,))
    body = serialize(document, syntax)
    node, own = NamedNode(f"{URL}#message"), NamedNode(f"{URL}#message;geometry")
    triples = document.all_triples()
    assert {(each.predicate, each.object) for each in triples if each.subject == own} == {
        (rdf.type, geo.Geometry),
        (rdf.type, sf.Point),
        (geo.asWKT, Literal(in_frame(f"POINT ZM(0.0 0.0 0.0 {STAMP})"), datatype=geo.wktLiteral)),
    }
    assert canonical(read(body, syntax)) == canonical(triples)
    assert repr(lowerer(schema).from_graph(parse_body(body, syntax.media_type, URL), node)) == repr(message)
