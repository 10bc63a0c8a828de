"""What proves the package: verification, exam, recipes of the shipped databases, benchmarks; run from a checkout."""
