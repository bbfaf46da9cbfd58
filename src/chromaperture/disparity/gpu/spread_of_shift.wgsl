// The logarithm of the standard deviation of the shift about the answer by nats at every shift; see `evidence_signs.py`.

fn log_spread(evidence: ptr<function, array<f32, shift_count>>) -> f32 {
    var most = (*evidence)[0];
    for (var s = 1u; s < shift_count; s++) { most = max(most, (*evidence)[s]); }
    var total = 0.0;
    var squares = 0.0;
    for (var s = 0u; s < shift_count; s++) {
        let likely = exp((*evidence)[s] - most) * shifts[shift_count + s];
        total += likely;
        squares += likely * shifts[s] * shifts[s];
    }
    return log(sqrt(squares / total) + least_spread);
}
