// Signs of an error that the surface itself gives, weighed; see `learned_error_bar.signs`. They count in layers.

fn weighed(value: f32, weight: f32, least: f32, most: f32) -> f32 {
    return weight * clamp(value, least, most);
}

// Of the pooled variance of the posterior, and of the range of the surface within a short and a long reach.
fn weighed_surface(variance: f32, near: f32, far: f32) -> f32 {
    return weighed(log(sqrt(variance) + 0.02), posterior[0], posterior[1], posterior[2])
        + weighed(log(near + 0.1), range_8[0], range_8[1], range_8[2])
        + weighed(log(far + 0.1), range_32[0], range_32[1], range_32[2]);
}
