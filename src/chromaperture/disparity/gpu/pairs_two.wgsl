// Two views: their means at a pixel, and the one covariance of the pair.
alias Means = vec2f;
alias Covariances = f32;

fn products(apart: Means) -> Covariances {
    return apart.x * apart.y;
}

fn score_of(correlation: Covariances) -> f32 {
    return clamp(correlation, -1.0, 1.0);
}
