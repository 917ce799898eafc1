"""Scores that an insurer prices with and a driver understands: how much (PAYD), how (PHYD) and where (PWYD).

All of it is pure: the same record, period and model give the same bits. What callers use:

``record``: ``Record`` (what was driven; ``total(records)`` adds), ``Evidence``.
``model``: ``score_model_of(document) -> ScoreModel`` (``name``, ``version``, ``sha256``);
    the shipped one is ``service.scoring.loading.shipped_model()``.
``products``: ``score(product, record, days, model, places=None) -> Score`` and
    ``scores(record, days, model, places=None) -> {Product: Score}``, or ``payd.payd(record, days, model)``,
    ``phyd.phyd(record, days, model)``, ``pwyd.pwyd(record, days, model, places=None)``. ``days`` is the period's
    length, driven or not. ``Score.score`` is None, with ``reason``, where nothing was driven or (PWYD) no
    place is known. InvalidInputError: no such product, a period of none, a record of more days than
    the period has.
``score``: ``Score`` (``to_json()`` for answers), ``Contribution``, ``Product`` (``payd``, ``phyd``, ``pwyd``).
``explaining``: ``explain(score) -> tuple[Explained(name, sentence), ...]``.
``places``: ``places_from(exposure: {cell: Driven}, accidents: {cell: int}) -> Places`` out of a portfolio's sums,
    ``Places.to_json()``, ``places_of(json)``; ``sha256`` goes into the score as ``places_sha256``.
``premium``: ``tariff_of(document) -> Tariff``, ``quote(tariff, scores, days) -> Quote``, ``Quote.to_json()``.
``fitting``: ``fitted(document, [(record, days), ...]) -> document`` puts a portfolio's own values into a model.
``fairness``: ``fairness(rows) -> dict`` of rows (age, sex, score, predicted, claims).

A contribution's evidence is what the record keeps under its name: ``mileage``, ``braking``, ``acceleration``,
``cornering``, ``lane_change``, ``speeding`` (for both of its contributions), ``vehicle``; of hours, roads, districts
and cells under each of its labels, as ``hour:08``, ``road_class:<class>``, ``district:<name>``, ``cell:<id>``.
"""
