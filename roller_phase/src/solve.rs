//! Normal equations of any size.

/// Inverts a symmetric positive definite matrix of `size` rows in place; `false` when it is not
/// one, or nearly not.
pub(crate) fn invert(matrix: &mut [f64], size: usize) -> bool {
    let diagonal: Vec<f64> = (0..size).map(|n| matrix[n * size + n]).collect();
    eliminate(matrix, &diagonal)
}

/// The same for three rows.
pub(crate) fn invert_three(matrix: &mut [f64; 9]) -> bool {
    let diagonal = [matrix[0], matrix[4], matrix[8]];
    eliminate(matrix, &diagonal)
}

/// Gauss-Jordan; no pivoting, because the matrix is positive.
#[inline(always)]
fn eliminate(matrix: &mut [f64], diagonal: &[f64]) -> bool {
    let size = diagonal.len();
    for (pivot, first) in diagonal.iter().enumerate() {
        let head = matrix[pivot * size + pivot];
        if head <= 1e-12 * first || !head.is_finite() {
            return false;
        }
        matrix[pivot * size + pivot] = 1.0;
        for column in 0..size {
            matrix[pivot * size + column] /= head;
        }
        for row in (0..size).filter(|row| *row != pivot) {
            let factor = std::mem::take(&mut matrix[row * size + pivot]);
            for column in 0..size {
                matrix[row * size + column] -= factor * matrix[pivot * size + column];
            }
        }
    }
    true
}

/// Sum of products.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whole numbers: the inverse of [[2, 1], [1, 1]] is [[1, -1], [-1, 2]]; [[1, 1], [1, 1]] has
    /// none.
    #[test]
    fn inverts_what_has_an_inverse() {
        let mut matrix = [2.0, 1.0, 1.0, 1.0];
        assert!(invert(&mut matrix, 2));
        assert_eq!(matrix, [1.0, -1.0, -1.0, 2.0]);
        assert!(!invert(&mut [1.0; 4], 2));
    }
}
