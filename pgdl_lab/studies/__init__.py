"""What is measured with the lab: charts, choices, stability, verification."""
