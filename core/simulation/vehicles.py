"""What classes of vehicles differ in, for what is simulated of them: mass, springs, brakes, tyres, engine, crashes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from core.measurements import FloatArray
from core.simulation.ride import Car
from core.tunables import Tunables, tunable

_CAR_BODY: Final = Car()


@dataclass(frozen=True, slots=True)
class Vehicle(Tunables):
    """A class of vehicles; the defaults are a car's.

    ``body`` is the middle of the class, each vehicle of it 0.8 to 1.6 of that mass. A crash of a class is a car's with
    its change of velocity multiplied by ``share`` and its length by ``stretch``, each drawn between least and most.
    """

    body: Car = _CAR_BODY
    tracks: int = tunable(2, unit="1", low=1, high=2, source="one: a motorcycle, that leans into bends and falls over")
    box_forward_m: float = tunable(
        0.9, unit="m", low=-5.0, high=8.0, source="choice: a box under the dashboard, from the centre of gravity"
    )
    box_right_m: float = tunable(0.1, unit="m", low=-1.5, high=1.5, source="choice")
    box_down_m: float = tunable(-0.25, unit="m", low=-3.0, high=1.0, source="choice")
    braking_least_mps2: float = tunable(
        6.0, unit="m/s2", low=2.0, high=12.0, source="dry asphalt allows 7 to 10 (Gillespie 1992, ch. 3)"
    )
    braking_most_mps2: float = tunable(10.8, unit="m/s2", low=2.0, high=12.0, source="choice: sports tyres, 1.1 g")
    brakes_least_s: float = tunable(0.1, unit="s", low=0.02, high=2.0, source="choice: with brake assist")
    brakes_most_s: float = tunable(0.4, unit="s", low=0.02, high=2.0, source="choice: pedal pressed without haste")
    side_least_mps2: float = tunable(5.0, unit="m/s2", low=1.0, high=12.0, source="choice: a hard bend begins")
    side_most_mps2: float = tunable(10.0, unit="m/s2", low=1.0, high=12.0, source="choice: tyres' reach")
    top_mps: float = tunable(37.0, unit="m/s", low=5.0, high=60.0, source="choice: motorway, 133 km/h")
    hurry: float = tunable(1.0, unit="1", low=0.1, high=2.0, source="choice: everyday acceleration against a car's")
    engine_mps2: float = tunable(0.06, unit="m/s2", low=0.0, high=10.0, source="choice: sd of what the engine shakes")
    engine_hz: float = tunable(27.0, unit="Hz", low=5.0, high=300.0, source="choice: four cylinders near idle")
    road_share: float = tunable(
        1.0, unit="1", low=0.1, high=5.0, source="how a road shakes the box, against a car: shocks_road_anomalies_2017"
    )
    cab_share: float = tunable(
        0.0, unit="1", low=0.0, high=2.0, source="a cab on springs of its own adds so much about 1.5 to 4 Hz; none here"
    )
    share_least: float = tunable(1.0, unit="1", low=0.05, high=2.0, source="a car's crash as it is")
    share_most: float = tunable(1.0, unit="1", low=0.05, high=2.0, source="a car's crash as it is")
    stretch_least: float = tunable(1.0, unit="1", low=0.3, high=4.0, source="a car's crash as it is")
    stretch_most: float = tunable(1.0, unit="1", low=0.3, high=4.0, source="a car's crash as it is")

    @property
    def leans(self) -> bool:
        """Whether it leans into bends: on one track."""
        return self.tracks == 1

    @property
    def box_m(self) -> FloatArray:
        """The box forward, right and down of the centre of gravity, (3,), m."""
        return np.array([self.box_forward_m, self.box_right_m, self.box_down_m])


CAR: Final = Vehicle()

VEHICLES: Final[Mapping[str, Vehicle]] = MappingProxyType(
    {
        "car": CAR,
        # Half as heavy again as a car, a Diesel engine, harder springs behind (choice).
        "van": Vehicle(
            body=Car(
                sprung_kg=1900.0, unsprung_kg=50.0, pitch_kgm2=4200.0, roll_kgm2=950.0, front_m=1.5, rear_m=1.8,
                half_track_m=0.85, height_m=0.75, spring_npm=38000.0, damping_nspm=2600.0, stop_npm=400000.0,
                tyre_npm=280000.0, wheel_radius_m=0.34,
            ),
            box_forward_m=1.5, box_down_m=-0.4, braking_least_mps2=5.5, braking_most_mps2=9.5,
            side_least_mps2=4.0, side_most_mps2=8.0, top_mps=36.0, engine_mps2=0.12, road_share=1.2,
            share_least=0.7, share_most=1.0, stretch_least=1.0, stretch_most=1.25,
        ),
        # UN R13: 5 m/s2 with brakes that answer within 0.6 s; laden trucks tip over from 3 to 5 m/s2 sideways on.
        # A blow changes its velocity by 0.35 to 0.8 of what it would a car's, and its frame gives way more slowly;
        # choices, as masses and springs are (Gillespie 1992, ch. 5: a truck's axle hops at 10 Hz, it bounces near 2).
        "truck": Vehicle(
            body=Car(
                sprung_kg=9000.0, unsprung_kg=350.0, pitch_kgm2=32000.0, roll_kgm2=7000.0, front_m=2.0, rear_m=2.2,
                half_track_m=1.0, height_m=1.3, spring_npm=260000.0, damping_nspm=9500.0, travel_m=0.08, stop_npm=2e6,
                tyre_npm=900000.0, tyre_nspm=600.0, rim_m=0.12, rim_npm=5e6, wheel_radius_m=0.5,
            ),
            box_forward_m=2.6, box_down_m=-1.0, braking_least_mps2=4.5, braking_most_mps2=7.0,
            brakes_least_s=0.25, brakes_most_s=0.6, side_least_mps2=2.5, side_most_mps2=4.5, top_mps=25.0, hurry=0.6,
            engine_mps2=0.3, engine_hz=33.0, road_share=1.5, cab_share=0.6,
            share_least=0.35, share_most=0.8, stretch_least=1.2, stretch_most=1.8,
        ),
        # UN R80 tries a coach's seats at 30 to 32 km/h within some 120 ms (6.5 to 8.5 g on average); choices beside.
        "bus": Vehicle(
            body=Car(
                sprung_kg=9500.0, unsprung_kg=330.0, pitch_kgm2=90000.0, roll_kgm2=9000.0, front_m=3.2, rear_m=2.6,
                half_track_m=1.05, height_m=1.2, spring_npm=150000.0, damping_nspm=9000.0, travel_m=0.08,
                stop_npm=1.5e6, tyre_npm=900000.0, tyre_nspm=600.0, rim_m=0.12, rim_npm=5e6, wheel_radius_m=0.5,
            ),
            box_forward_m=5.0, box_right_m=-0.5, box_down_m=-0.4, braking_least_mps2=4.5, braking_most_mps2=7.0,
            brakes_least_s=0.25, brakes_most_s=0.6, side_least_mps2=2.5, side_most_mps2=4.5, top_mps=28.0, hurry=0.7,
            engine_mps2=0.15, engine_hz=30.0, road_share=1.2,
            share_least=0.4, share_most=0.9, stretch_least=1.1, stretch_most=1.6,
        ),
        # With a rider. UN R78 asks 6.4 m/s2; the rear wheel lifts at 9 to 10. Leans to 45 degrees
        # at its tyres' reach. It crashes with its fork and wheel, which give way within 40 to 130 ms (choice).
        "motorcycle": Vehicle(
            body=Car(
                sprung_kg=260.0, unsprung_kg=9.0, pitch_kgm2=50.0, roll_kgm2=20.0, front_m=0.75, rear_m=0.7,
                half_track_m=0.1, height_m=0.65, spring_npm=10500.0, damping_nspm=600.0, travel_m=0.06,
                stop_npm=80000.0, tyre_npm=75000.0, tyre_nspm=80.0, rim_m=0.06, rim_npm=5e5, wheel_radius_m=0.3,
            ),
            tracks=1, box_forward_m=-0.3, box_right_m=0.0, box_down_m=-0.15, braking_least_mps2=5.5,
            braking_most_mps2=9.5, brakes_least_s=0.12, brakes_most_s=0.5, side_least_mps2=5.0, side_most_mps2=10.0,
            top_mps=37.0, hurry=1.5, engine_mps2=1.2, engine_hz=45.0, road_share=1.4,
            share_least=0.8, share_most=1.2, stretch_least=0.55, stretch_most=0.95,
        ),
    }
)  # fmt: skip
"""By the class that a vehicle is registered with (``core.accident.profiles``)."""
