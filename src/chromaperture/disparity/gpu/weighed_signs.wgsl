// A sign of an error as it counts in the learned error bar; see `learned_error_bar.py`.

// `model`: weight, and the least and the most that counts.
fn weighed(value: f32, model: array<f32, 3>) -> f32 {
    return model[0] * clamp(value, model[1], model[2]);
}

fn log_of_posterior(variance: f32) -> f32 {
    return log(sqrt(variance) + 0.02);
}
