// Three views: their means at a pixel, and the covariances of the pairs 01, 02, 12.
alias Means = vec3f;
alias Covariances = vec3f;

fn products(apart: Means) -> Covariances {
    return vec3f(apart.x * apart.y, apart.x * apart.z, apart.y * apart.z);
}

fn score_of(correlations: Covariances) -> f32 {
    let r = clamp(correlations, vec3f(-1.0), vec3f(1.0));
    // The determinant 1 + 2 xyz - xx - yy - zz, without the difference of numbers near 1 where all are alike.
    let rest = r.z - r.x * r.y;
    return 1.0 - sqrt(max((1.0 - r.x) * (1.0 + r.x) * (1.0 - r.y) * (1.0 + r.y) - rest * rest, 0.0));
}
