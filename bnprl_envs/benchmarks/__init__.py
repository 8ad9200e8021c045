"""The discrete benchmarks, one short file each: a function that returns a `TabularModel`."""
