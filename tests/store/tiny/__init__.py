"""Two stages whose numbers anybody can work out: for trials of the store and the engine, not of photometry."""

TABLE = {
    "capture": "lightstage.stages.capture",
    "scaled": "tests.store.tiny.scaled",
    "summed": "tests.store.tiny.summed",
}
PIPELINE = """stages:
  capture: {uses: capture}
  scaled: {uses: scaled, from: capture}
  summed: {uses: summed, from: scaled}
"""
