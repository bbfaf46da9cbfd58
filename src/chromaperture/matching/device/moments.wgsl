// Means of the views in a window, variances and covariances, of four layers; and what an exponential window makes of
// them, sample after sample (West 1979), as `windows_x.wgsl`.
struct Moments {
    means: array<vec4f, view_count>,
    spreads: array<vec4f, moment_count>,
}

const moment_pitch = view_count + moment_count;

// The window with one more sample, or with what the window along the other axis says of it.
fn joined(state: Moments, here: Moments) -> Moments {
    var apart: array<vec4f, view_count>;
    var found: Moments;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        apart[k] = here.means[k] - state.means[k];
        found.means[k] = state.means[k] + (1.0 - decay) * apart[k];
    }
    let products = spread(apart);
    for (var m = 0u; m < moment_count; m++) {  // unrolled
        let own = (1.0 - decay) * here.spreads[m];
        found.spreads[m] = decay * (state.spreads[m] + (1.0 - decay) * products[m]) + own;
    }
    return found;
}

// The window that begins behind the last sample and looks back to where all is as this one: `state` is the window up to
// it. Both are sums of the powers of the decay.
fn begun_behind(state: Moments, last: Moments) -> Moments {
    var apart: array<vec4f, view_count>;
    var found: Moments;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        apart[k] = last.means[k] - state.means[k];
        found.means[k] = last.means[k] - decay / (1.0 + decay) * apart[k];
    }
    let products = spread(apart);
    for (var m = 0u; m < moment_count; m++) {  // unrolled
        let of_apart = decay / ((1.0 + decay) * (1.0 + decay)) * products[m];
        found.spreads[m] = (decay * state.spreads[m] + last.spreads[m]) / (1.0 + decay) + of_apart;
    }
    return found;
}
