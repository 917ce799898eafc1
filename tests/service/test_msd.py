"""The eCall data by EN 15722's units, against values worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from schemas.evidence import Msd
from schemas.vehicles import VehicleConfig
from service.evidence.msd import minimum_set_of_data
from service.storage.accidents import AccidentRow
from service.storage.trips import TrackRow
from tests.service.stored_rows import accident_row, point_row

ROW = AccidentRow(**accident_row("acme", 1, 0, lat_deg=48.3003333, lon_deg=11.6178333), vehicle_id="car", trip_id=None)


def places(*degrees: tuple[float, float]) -> list[TrackRow]:
    rows = [point_row(1, -5 * n, lat, lon) for n, (lat, lon) in enumerate(degrees, 1)]
    defaults = dict.fromkeys(TrackRow.__slots__)
    return [TrackRow(**{**defaults, **{k: v for k, v in row.items() if k in TrackRow.__slots__}}) for row in rows]


def structure(row: AccidentRow = ROW, config: VehicleConfig | None = None, recent: tuple = ()) -> dict:
    found = minimum_set_of_data(row, config or VehicleConfig(), places(*recent))
    Msd.model_validate(found)
    return found["msd"]["msdStructure"]


def test_positions_are_in_milliarcseconds_and_directions_in_two_degrees() -> None:
    said = structure(replace(ROW, heading_deg=271.0))
    # 48 deg 18 min 1.2 s north, 11 deg 37 min 4.2 s east.
    assert said["vehicleLocation"] == {"positionLatitude": 173_881_200, "positionLongitude": 41_824_200}
    assert said["vehicleDirection"] == 136  # 135.5, to even
    assert structure(replace(ROW, heading_deg=359.5))["vehicleDirection"] == 0
    assert said["timestamp"] == 1_800_000_000


def test_recent_locations_are_steps_of_a_tenth_of_an_arcsecond_each_against_the_one_after() -> None:
    second = 1.0 / 3600.0
    lat, lon = ROW.lat_deg, ROW.lon_deg
    said = structure(recent=((lat - 2.0 * second, lon + 1.0 * second), (lat - 5.0 * second, lon + 1.0 * second)))
    assert said["recentVehicleLocationN1"] == {"latitudeDelta": -20, "longitudeDelta": 10}
    assert said["recentVehicleLocationN2"] == {"latitudeDelta": -30, "longitudeDelta": 0}


def test_a_recent_location_too_far_away_is_left_out_and_so_is_what_refers_to_it() -> None:
    lat, lon = ROW.lat_deg, ROW.lon_deg
    said = structure(recent=((lat + 0.02, lon), (lat + 0.02, lon)))
    assert said["recentVehicleLocationN1"] is said["recentVehicleLocationN2"] is None


def test_what_is_not_known_is_said_as_the_standard_has_it() -> None:
    said = structure(replace(ROW, lat_deg=None, lon_deg=None, sd_n_m=None, heading_deg=None))
    assert said["vehicleLocation"] == {"positionLatitude": 2**31 - 1, "positionLongitude": 2**31 - 1}
    assert said["vehicleDirection"] == 255
    assert said["control"]["positionCanBeTrusted"] is False
    assert said["vehicleIdentificationNumber"] is said["vehiclePropulsionStorageType"] is None


@pytest.mark.parametrize(("sd_m", "trusted"), [(1.0, True), (61.0, True), (62.0, False), (500.0, False)])
def test_a_position_is_trusted_that_lies_within_150_m_with_95_percent(sd_m: float, trusted: bool) -> None:
    # 2.45 sd hold 95 % of a plane's normal distribution: 150 m / 2.45 = 61.3 m.
    assert structure(replace(ROW, sd_n_m=1.0, sd_e_m=sd_m))["control"]["positionCanBeTrusted"] is trusted


def test_the_vehicle_says_what_it_is() -> None:
    config = VehicleConfig(vin="WVWZZZ1KZAW000001", vehicle_class="van", propulsion=("diesel", "electric"))
    said = structure(config=config)
    assert said["vehicleIdentificationNumber"] == {
        "isowmi": "WVW", "isovds": "ZZZ1KZ", "isovisModelyear": "A", "isovisSeqPlant": "W000001",
    }  # fmt: skip
    assert said["control"]["vehicleType"] == "lightCommercialVehiclesClassN1"
    tanks = said["vehiclePropulsionStorageType"]
    assert [name for name, there in tanks.items() if there] == ["dieselTankPresent", "electricEnergyStorage"]
    assert len(tanks) == 7
    with pytest.raises(ValueError, match="vin"):
        VehicleConfig(vin="WVWZZZ1KZAW00000O")


def test_each_revision_is_another_message_and_tells_its_change_of_velocity() -> None:
    found = minimum_set_of_data(replace(ROW, revision=3), VehicleConfig(), [])
    assert found["msd"]["msdStructure"]["messageIdentifier"] == 4
    told = found["msd"]["optionalAdditionalData"]["data"]
    assert told["deltaVLongitudinalKmh"] == -32.4
    assert told["deltaVInterval95Kmh"] == [28.08, 36.72]
