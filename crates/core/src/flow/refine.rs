//! Variational refinement (Brox et al. 2004, "High accuracy optical flow estimation based on a theory for
//! warping"; Kroeger et al. 2016, §2.3): the flow that minimises
//!
//! E = Σ δ Ψ(brightness²) + γ Ψ(gradient²) + α Ψ(|∇u|² + |∇v|²), Ψ(s²) = √(s² + ε²).
//!
//! Each constancy is divided by the length of its slope, so that edges count no more than texture (Zimmer et
//! al. 2011, "Optic flow in harmony").

use super::{Vector, pyramid, relax};
use crate::grid::Grid;

/// δ of constant brightness.
const BRIGHTNESS: f32 = 5.0;
/// γ of constant gradient.
const GRADIENT: f32 = 10.0;
/// α of smoothness.
const SMOOTHNESS: f32 = 20.0;
/// ε², px².
const EPSILON_2: f32 = 1e-6;
/// Addend to the square of a slope's length, levels² per px²: slopes below its root are noise.
const ZETA_2: f32 = 0.01;
/// Times that the constancies are linearised around the flow found so far.
const WARPS: usize = 2;
/// Times that the robust weights are computed anew, for each linearisation.
const ROUNDS: usize = 5;

/// One linear constraint [a, b, c] on the flow of a pixel: a u + b v + c = 0.
type Constraint = [f32; 3];

/// Constancy of brightness, of the slope along x and of that along y.
type Constraints = [Constraint; 3];

/// Returns the flow that fits the images and is smooth, near the given one.
pub(super) fn refined(from: &Grid<f32>, to: &Grid<f32>, mut flow: Grid<Vector>) -> Grid<Vector> {
    for _ in 0..WARPS {
        let constraints = constraints(from, to, &flow);
        for _ in 0..ROUNDS {
            let pulls = pulls(&flow);
            let cells = pyramid::each_pixel(flow.width, flow.height, |x, y| {
                let (matrix, target) = data_term(&constraints.at(x, y), flow.at(x, y));
                relax::Cell::new(matrix, target, neighbour_pulls(&pulls, x, y))
            });
            relax::relax(&cells, &mut flow);
        }
    }
    flow
}

/// Linearises the constancies around the given flow. Pixels that leave the image have none.
fn constraints(from: &Grid<f32>, to: &Grid<f32>, flow: &Grid<Vector>) -> Grid<Constraints> {
    let (width, height) = (from.width, from.height);
    let place = |x: usize, y: usize| {
        let [u, v] = flow.at(x, y);
        [x as f32 + u, y as f32 + v]
    };
    let both = pyramid::each_pixel(width, height, |x, y| {
        let (here, there) = (from.at(x, y), pyramid::level_at(to, place(x, y)));
        [(here + there) / 2.0, there - here]
    });
    let [mean, change] = [0, 1].map(|k| both.map(|pair| pair[k]));
    let [dx, dy] = pyramid::slopes(&mean);
    let [change_dx, change_dy] = pyramid::slopes(&change);
    let ([dxx, dxy], [_, dyy]) = (pyramid::slopes(&dx), pyramid::slopes(&dy));
    pyramid::each_pixel(width, height, |x, y| {
        let [to_x, to_y] = place(x, y);
        let inside =
            (0.0..=(width - 1) as f32).contains(&to_x) && (0.0..=(height - 1) as f32).contains(&to_y);
        if !inside {
            return Constraints::default();
        }
        let flow = flow.at(x, y);
        [[&dx, &dy, &change], [&dxx, &dxy, &change_dx], [&dxy, &dyy, &change_dy]].map(|planes| {
            let [a, b, c] = planes.map(|plane| plane.at(x, y));
            let scale = 1.0 / (a * a + b * b + ZETA_2).sqrt();
            [a, b, c - a * flow[0] - b * flow[1]].map(|value| value * scale)
        })
    })
}

/// Matrix [uu, uv, vv] and right side of the data term at one pixel, with robust weights for this flow.
fn data_term(constraints: &Constraints, [u, v]: Vector) -> ([f32; 3], Vector) {
    let [brightness, along_x, along_y] = constraints.map(|[a, b, c]| (a * u + b * v + c).powi(2));
    let of_brightness = BRIGHTNESS / (brightness + EPSILON_2).sqrt();
    let of_gradient = GRADIENT / (along_x + along_y + EPSILON_2).sqrt();
    let (mut matrix, mut target) = ([0.0; 3], [0.0; 2]);
    for ([a, b, c], weight) in constraints.iter().zip([of_brightness, of_gradient, of_gradient]) {
        matrix = [matrix[0] + weight * a * a, matrix[1] + weight * a * b, matrix[2] + weight * b * b];
        target = [target[0] - weight * a * c, target[1] - weight * b * c];
    }
    (matrix, target)
}

/// Robust weight of smoothness at each pixel, for differences to the right and to the lower neighbour.
fn pulls(flow: &Grid<Vector>) -> Grid<f32> {
    let (right, bottom) = (flow.width - 1, flow.height - 1);
    pyramid::each_pixel(flow.width, flow.height, |x, y| {
        let [u, v] = flow.at(x, y);
        let squares = [flow.at((x + 1).min(right), y), flow.at(x, (y + 1).min(bottom))]
            .map(|other| (other[0] - u).powi(2) + (other[1] - v).powi(2));
        SMOOTHNESS / (squares[0] + squares[1] + EPSILON_2).sqrt()
    })
}

/// Pulls of the neighbours left, right, above and below; 0 outside.
fn neighbour_pulls(pulls: &Grid<f32>, x: usize, y: usize) -> [f32; 4] {
    let here = pulls.at(x, y);
    [
        if x > 0 { pulls.at(x - 1, y) } else { 0.0 },
        if x + 1 < pulls.width { here } else { 0.0 },
        if y > 0 { pulls.at(x, y - 1) } else { 0.0 },
        if y + 1 < pulls.height { here } else { 0.0 },
    ]
}
