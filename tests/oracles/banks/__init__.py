"""Banks of data with hidden effects that diagnoses are judged on: made by hidden_effects, diagnosed by ctrplan, scored."""
