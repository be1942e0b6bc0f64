"""Relations of sensors and the entities that they perceive."""

from __future__ import annotations

from ssduck.sql.relations.common import recorded_numbers
from ssduck.sql.relations.relation import Parameter, Relation

_SENSOR = (Parameter("s", "entity", "a sensor"),)
_SENSOR_AND_OTHER = (*_SENSOR, Parameter("e", "entity", "another entity"))

SENSOR_RELATIONS: tuple[Relation, ...] = (
    Relation(
        "isSensing",
        _SENSOR_AND_OTHER,
        "boolean",
        "(s.id, e.id) IN (SELECT sensor, entity FROM sensings)",
        "Checks if sensor s perceives e at the tick: if a ray, a pixel or a contact point of s "
        "ends on e. It is False while s is switched off, for the body on which s is mounted, if "
        "e is a sensor, and if s is not one.",
        recorded_formula=f"len({recorded_numbers('sensed', 's', 'e')}) > 0",
    ),
    Relation(
        "sensingAmount",
        _SENSOR_AND_OTHER,
        "double",
        "COALESCE(map_extract_value((SELECT map(list((sensor, entity)), list(hits / rays)) "
        "FROM sensings), (s.id, e.id)), 0.0::DOUBLE)",
        "Returns the share of the rays, pixels or contact points of sensor s that end on e, "
        "from 0 to 1; 0 if isSensing(s, e) is False.",
        recorded_formula=f"COALESCE({recorded_numbers('sensed', 's', 'e')}[1], 0.0)",
    ),
    Relation(
        "sensingEnvIDs",
        _SENSOR,
        "list",
        "COALESCE(map_extract_value((SELECT map(list(sensor), list(ids)) FROM (SELECT sensor, "
        "list(entity ORDER BY entity) AS ids FROM sensings GROUP BY sensor) AS seen), s.id), "
        "[]::BIGINT[])",
        "Returns the ids (see environmentID) of the entities that sensor s perceives at the "
        "tick, in ascending order; an empty list while it is switched off.",
        element="integer",
        recorded_formula=f"{recorded_numbers('perceived', 's')}::BIGINT[]",
    ),
)
