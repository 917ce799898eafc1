"""A map of streets that are nowhere, written as an OpenStreetMap extract: what tests of roads build and drive on."""

from __future__ import annotations

import math

LAT0, LON0 = 59.5, 20.0
"""In the Baltic Sea."""
M_PER_DEG = 111_412.0
"""Of the meridian at this latitude, WGS-84."""
M_PER_DEG_LON = 56_745.0


def at(x_m, y_m):
    """Longitude and latitude of a place so far east and north of the map's origin."""
    return LON0 + x_m / M_PER_DEG_LON, LAT0 + y_m / M_PER_DEG


MAIN, RURAL, MPH, PARALLEL, MOTORWAY, TWO_LIMITS, TUNNEL, WALK, BORDER, FOOTWAY, LOOP, NONSENSE, SERVICE = range(
    101, 114
)

STREETS = {
    MAIN: ([(x, 0) for x in range(0, 2001, 250)], {"highway": "primary", "name": "Hauptweg", "maxspeed": "50"}),
    RURAL: ([(x, 0) for x in range(2000, 6001, 500)], {"highway": "secondary", "name": "Landweg"}),
    MPH: ([(500, 0), (500, 60), (500, 600)], {"highway": "residential", "name": "Nordgasse", "maxspeed": "30 mph"}),
    PARALLEL: ([(x, 60) for x in range(0, 1501, 250)], {"highway": "residential", "name": "Parallelgasse"}),
    MOTORWAY: (
        [(x, -900) for x in range(0, 6001, 500)],
        {"highway": "motorway", "ref": "A 1", "oneway": "yes", "motorroad": "yes"},
    ),
    TWO_LIMITS: (
        [(1500, 0), (1500, 60), (1500, 600)],
        {"highway": "tertiary", "name": "Zweierlei, Weg", "maxspeed:forward": "40", "maxspeed:backward": "20"},
    ),
    TUNNEL: (
        [(1500, 600), (2000, 600), (2400, 600)],
        {
            "highway": "secondary",
            "name": "Tunnelweg",
            "tunnel": "yes",
            "maxspeed": "XY:urban",
            "source:maxspeed": "FI:urban",
        },
    ),
    WALK: ([(0, 0), (0, 60)], {"highway": "living_street", "name": "Spielgasse", "maxspeed": "walk"}),
    BORDER: ([(1000, 0), (1000, 60), (1000, 600)], {"highway": "residential", "name": "Grenzstraße"}),
    FOOTWAY: ([(250, 0), (250, 60)], {"highway": "footway"}),
    LOOP: ([(500, 600), (1000, 600), (1500, 600)], {"highway": "tertiary", "name": "Ringweg", "maxspeed": "30"}),
    NONSENSE: ([(2400, 600), (2600, 300), (2500, 0)], {"highway": "tertiary", "name": "Unsinnsweg", "maxspeed": "999"}),
    SERVICE: ([(750, 60), (750, 160)], {"highway": "service"}),
}

COUNTRY, WEST, EAST, CUT = 901, 902, 903, 904
_RING = [(-500, -1500), (3500, -1500), (3500, 1500), (-500, 1500), (-500, -1500)]
_BORDERS = {
    201: _RING,
    202: [(-500, 1200), (-500, -300), (1000, -300)],
    203: [(1000, -300), (1000, 0), (1000, 600), (1000, 1200)],
    204: [(1000, 1200), (-500, 1200)],
    205: [(1000, -300), (3000, -300), (3000, 1200), (1000, 1200)],
    206: [(4800, 1400), (4800, 0), (4800, -1400)],
}
"""Lines by way id. The last one leaves the map at both ends, like that of a district that the extract cuts off."""
_BUILT_UP = {401: [(800, -80), (1200, -80), (1200, 80), (800, 80), (800, -80)]}
"""Where the middle of the Hauptweg lies; its streets are too few to tell."""
_RELATIONS = {
    COUNTRY: ([201], {"admin_level": "2", "name": "Nordland", "ISO3166-1": "FI"}),
    WEST: ([202, 203, 204], {"admin_level": "9", "name": "Westviertel"}),
    EAST: ([203, 205], {"admin_level": "9", "name": "Ostviertel"}),
    CUT: ([206, 299], {"admin_level": "9", "name": "Fernviertel"}),
}
_PLACES = {301: ((5500, 300), "Fernviertel")}


def write_map(path, streets=None, **tags_of):
    """Write the map; ``streets`` in place of its own."""
    import osmium

    header = osmium.io.Header()
    (west, south), (east, north) = at(-1000, -1500), at(6500, 1500)
    header.add_box(osmium.osm.Box(osmium.osm.Location(west, south), osmium.osm.Location(east, north)))
    nodes, ways = {}, []
    lines = [(way, *street) for way, street in (STREETS if streets is None else streets).items()]
    lines += [(way, line, {"boundary": "administrative"}) for way, line in _BORDERS.items()]
    lines += [(way, line, {"landuse": "residential"}) for way, line in _BUILT_UP.items()]
    for way, line, tags in lines:
        refs = [nodes.setdefault(place, 1000 + len(nodes)) for place in line]
        ways.append(osmium.osm.mutable.Way(id=way, version=1, nodes=refs, tags=tags))
    with osmium.SimpleWriter(str(path), header=header) as writer:
        for ref, (place, name) in _PLACES.items():
            writer.add_node(
                osmium.osm.mutable.Node(id=ref, version=1, location=at(*place), tags={"place": "suburb", "name": name})
            )
        for place, ref in nodes.items():
            writer.add_node(osmium.osm.mutable.Node(id=ref, version=1, location=at(*place)))
        for way in sorted(ways, key=lambda one: one.id):
            writer.add_way(way)
        for relation, (members, tags) in _RELATIONS.items():
            writer.add_relation(
                osmium.osm.mutable.Relation(
                    id=relation,
                    version=1,
                    members=[("w", member, "outer") for member in members],
                    tags={"boundary": "administrative", "type": "boundary", **tags},
                )
            )
    return path


def heading_deg(dx_m, dy_m):
    """Heading of a direction, degrees clockwise from north."""
    return math.degrees(math.atan2(dx_m, dy_m))
