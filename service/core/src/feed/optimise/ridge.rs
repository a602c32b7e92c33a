//! Small symmetric positive definite systems.

/// Solves `left · v = right` by Cholesky and returns v with the first `wanted` diagonal elements of the inverse.
///
/// `left` is row-major and positive definite: every unknown has a prior on its diagonal.
pub(super) fn solve(mut left: Vec<f64>, right: Vec<f64>, wanted: usize) -> (Vec<f64>, Vec<f64>) {
    let size = right.len();
    for i in 0..size {
        for j in 0..=i {
            let mut sum = left[i * size + j];
            for k in 0..j {
                sum -= left[i * size + k] * left[j * size + k];
            }
            // A pivot that rounding has taken below zero is as small as rounding.
            left[i * size + j] = if i == j { sum.max(1e-12).sqrt() } else { sum / left[j * size + j] };
        }
    }
    let values = substitute(&left, right);
    let variances = (0..wanted)
        .map(|at| {
            let mut unit = vec![0.0; size];
            unit[at] = 1.0;
            substitute(&left, unit)[at]
        })
        .collect();
    (values, variances)
}

fn substitute(lower: &[f64], mut right: Vec<f64>) -> Vec<f64> {
    let size = right.len();
    for i in 0..size {
        for k in 0..i {
            right[i] -= lower[i * size + k] * right[k];
        }
        right[i] /= lower[i * size + i];
    }
    for i in (0..size).rev() {
        for k in i + 1..size {
            right[i] -= lower[k * size + i] * right[k];
        }
        right[i] /= lower[i * size + i];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::solve;

    #[test]
    fn a_system_is_solved_with_the_diagonal_of_its_inverse() {
        let (values, variances) = solve(vec![4.0, 2.0, 2.0, 3.0], vec![10.0, 8.0], 2);
        // Inverse: [3, −2; −2, 4] / 8.
        for (value, expected) in values.iter().chain(&variances).zip([1.75, 1.5, 0.375, 0.5]) {
            assert!((value - expected).abs() < 1e-12, "{value} is not {expected}");
        }
    }
}
