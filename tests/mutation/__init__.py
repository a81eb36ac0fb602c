"""Mutation runs: small faults are planted into a package, one at a time, and its tests must fail."""
