"""``telefuse scores``: score a record, and show the model and the tariff that scores and premiums go by."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from core.scoring.explaining import explain
from core.scoring.fitting import fitted
from core.scoring.model import score_model_of
from core.scoring.premium import quote
from core.scoring.products import score
from core.scoring.score import Product
from service.bench import fairness
from service.cli.progress import Phases
from service.errors import UsageError
from service.risk.districts import district_relativities
from service.scoring import loading


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's parts."""
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True, parser_class=type(parser))
    model = parts.add_parser("model", help="name, version and digest of the score model")
    model.add_argument(
        "--show", action="store_true", help="print the shipped file, with its sources, to begin one's own"
    )
    model.add_argument("--model", type=Path, metavar="FILE", help="check a model of your own instead")
    model.set_defaults(part_run=_model)
    tariff = parts.add_parser("tariff", help="print the example of a tariff, to begin one's own with")
    tariff.add_argument("--tariff", type=Path, metavar="FILE.toml", help="check a tariff of your own instead")
    tariff.set_defaults(part_run=_tariff)
    _configure_score(parts.add_parser("score", help="score a record, and quote a premium"))
    fit = parts.add_parser("fit", help="put a portfolio's own values into a model: what others do, and how they differ")
    fit.add_argument(
        "portfolio", type=Path, metavar="RECORDS.jsonl", help='{"days": N, "record": {…}} a line, a driver each'
    )
    fit.add_argument("--model", type=Path, metavar="FILE", help="the model to begin with (default: the shipped one)")
    fit.set_defaults(part_run=_fit)
    districts = parts.add_parser("districts", help="put relativities of districts into a model, from a CSV of rates")
    districts.add_argument(
        "file", type=Path, metavar="RATES.csv", help="columns district, rate and, if there, exposure"
    )
    districts.add_argument(
        "--model", type=Path, metavar="FILE", help="the model to begin with (default: the shipped one)"
    )
    districts.set_defaults(part_run=_districts)
    fair = parts.add_parser("fairness", help="scores by age and sex over a simulated portfolio with known claim rates")
    fair.add_argument(
        "--drivers", type=int, default=fairness.DRIVERS, metavar="N", help="how many (default %(default)s)"
    )
    fair.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    fair.set_defaults(part_run=_fairness)


def run(arguments: argparse.Namespace) -> int:
    """Run the part asked for."""
    return int(arguments.part_run(arguments))


def _configure_score(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("record", type=Path, metavar="RECORD.json", help="as the service tells it of a period")
    parser.add_argument("--days", type=float, required=True, metavar="N", help="length of the period, driven or not")
    parser.add_argument("--product", choices=[one.value for one in Product], help="only this one (default: all)")
    parser.add_argument("--tariff", type=Path, metavar="FILE.toml", help="quote a premium of these days by this tariff")
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="your own; see 'telefuse scores model --show' and 'fit'"
    )
    parser.add_argument("--places", type=Path, metavar="FILE.json", help="relativities of H3 cells, for pwyd")
    parser.add_argument("--explain", action="store_true", help="print sentences for the driver instead of JSON")
    parser.set_defaults(part_run=_score)


def _score(arguments: argparse.Namespace) -> int:
    if arguments.tariff is not None and arguments.product is not None:
        raise UsageError("--tariff needs all products; expected no --product beside it")
    model = loading.score_model(arguments.model)
    tariff = None if arguments.tariff is None else loading.tariff(arguments.tariff)
    places = None if arguments.places is None else loading.places(arguments.places)
    record = loading.record(arguments.record)
    asked = list(Product) if arguments.product is None else [Product(arguments.product)]
    found = {product: score(product, record, arguments.days, model, places) for product in asked}
    quoted = None if tariff is None else quote(tariff, found, arguments.days)
    if arguments.explain:
        for product, one in found.items():
            print(product.value.upper() + (":" if one.score is None else f" {one.score:.1f}:"))
            for explained in explain(one):
                print(f"  {explained.sentence}")
        if quoted is not None:
            print(f"premium {quoted.premium:f} {quoted.currency}:")
            for step in quoted.steps:
                print(f"  {step.change:+.4f}  {step.name}: {step.text}")
        return 0
    told: dict[str, Any] = {
        "scores": {
            product.value: one.to_json() | {"explained": [explained._asdict() for explained in explain(one)]}
            for product, one in found.items()
        }
    }
    print(json.dumps(told | ({} if quoted is None else {"quote": quoted.to_json()}), allow_nan=False))
    return 0


def _model(arguments: argparse.Namespace) -> int:
    if arguments.show:
        sys.stdout.write(loading.shipped_text("scores"))
        return 0
    model = loading.score_model(arguments.model)
    print(f"{model.name} {model.version} sha256 {model.sha256}")
    return 0


def _tariff(arguments: argparse.Namespace) -> int:
    if arguments.tariff is None:
        sys.stdout.write(loading.shipped_text("tariff"))
        return 0
    tariff = loading.tariff(arguments.tariff)
    print(f"{tariff.name} {tariff.version} sha256 {tariff.sha256}")
    return 0


def _fit(arguments: argparse.Namespace) -> int:
    document = loading.model_document(arguments.model)
    print(json.dumps(fitted(document, loading.portfolio(arguments.portfolio)), indent=2, allow_nan=False))
    return 0


def _districts(arguments: argparse.Namespace) -> int:
    document = loading.model_document(arguments.model)
    pwyd = document["pwyd"]
    labels = district_relativities(arguments.file)
    document |= {"pwyd": pwyd | {"district": pwyd["district"] | {"labels": labels}}}
    score_model_of(document)
    print(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))
    return 0


def _fairness(arguments: argparse.Namespace) -> int:
    with Phases() as phases:
        found = fairness.measure(arguments.drivers, phases.tell)
    print(json.dumps(found, allow_nan=False) if arguments.json else fairness.tables(found))
    return 0
