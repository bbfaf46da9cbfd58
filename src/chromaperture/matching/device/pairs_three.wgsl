// Three views, four layers at a time: a value of each view, and the covariances of the pairs 01, 02, 12.
alias Covariances = mat3x4f;

fn products(of_views: array<vec4f, 3>) -> Covariances {
    return mat3x4f(of_views[0] * of_views[1], of_views[0] * of_views[2], of_views[1] * of_views[2]);
}

fn scores_of(covariances: Covariances, gains: Covariances) -> vec4f {
    let x = clamp(covariances[0] * gains[0], vec4f(-1.0), vec4f(1.0));
    let y = clamp(covariances[1] * gains[1], vec4f(-1.0), vec4f(1.0));
    let z = clamp(covariances[2] * gains[2], vec4f(-1.0), vec4f(1.0));
    // The determinant 1 + 2 xyz - xx - yy - zz, without the difference of numbers near 1 where all are alike.
    let rest = z - x * y;
    return 1.0 - sqrt(max((1.0 - x) * (1.0 + x) * (1.0 - y) * (1.0 + y) - rest * rest, vec4f()));
}
