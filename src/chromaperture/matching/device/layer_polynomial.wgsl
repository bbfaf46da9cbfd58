// Numbers of all layers, `ladder`, from its third on, and the polynomial through six of them.

var<workgroup> ladder: array<f32, layers + 4u>;

// At the part t of the way from a layer to the next one.
fn through_six(low: u32, t: f32) -> f32 {
    let a = t + 2.0;
    let b = t + 1.0;
    let c = t - 1.0;
    let d = t - 2.0;
    let e = t - 3.0;
    let between = a * e * (t * b * d * ladder[low + 3u] - b * c * d * ladder[low + 2u]) / 12.0;
    let beside = t * c * a * e * (d * ladder[low + 1u] - b * ladder[low + 4u]) / 24.0;
    let outer = b * t * c * d * (a * ladder[low + 5u] - e * ladder[low]) / 120.0;
    return between + beside + outer;
}
