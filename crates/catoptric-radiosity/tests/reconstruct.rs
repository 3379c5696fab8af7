//! The vertex rules of the classical pictures on regular meshes, to the letter.

use glam::Vec3;

use catoptric_radiosity::reconstruct::{Cells, unshared};
use catoptric_scene::{Rgb, Side, TriangleId};
use catoptric_solution::{DisplayMesh, DisplayVertex, Element, Face, FaceId};

/// A square face of n × n cells, each of two triangles with the diagonal in turns.
fn grid(n: u32) -> DisplayMesh {
    let at = |i: u32, j: u32| DisplayVertex {
        position: Vec3::new(i as f32, j as f32, 0.0),
        normal: Vec3::Z,
        triangle: TriangleId(0),
        side: Side::Front,
    };
    let vertices = (0..=n).flat_map(|j| (0..=n).map(move |i| at(i, j))).collect();
    let index = |i: u32, j: u32| j * (n + 1) + i;
    let mut elements = Vec::new();
    for j in 0..n {
        for i in 0..n {
            let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
            let triangles = if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            elements.extend(triangles.map(|vertices| Element { vertices }));
        }
    }
    let face = Face { elements: 0..elements.len() as u32, origin: Vec3::ZERO, axes: [Vec3::X, Vec3::Y] };
    DisplayMesh::new(vertices, elements, vec![face], [vec![FaceId(0)], vec![FaceId::NONE]])
}

/// Light of the cells, row by row from below, for both triangles of each.
fn elements(cells: &[f32]) -> Vec<Rgb> {
    cells.iter().flat_map(|&b| [Rgb::splat(b); 2]).collect()
}

#[test]
fn every_two_triangles_of_a_grid_are_a_cell() {
    for n in [1, 2, 5] {
        assert_eq!(Cells::new(&grid(n)).count(), ((n * n) as usize, 0));
    }
}

#[test]
fn the_rules_for_inner_edge_and_corner_vertices_are_those_of_the_lecture() {
    let mesh = grid(2);
    let cells = Cells::new(&mesh);
    // B₁ below left, B₂ below right, B₃ above left, B₄ above right.
    let [b1, b2, b3, b4] = [5.0, 3.0, 2.0, 4.0];
    let light = elements(&[b1, b2, b3, b4]);
    let averaged: Vec<f32> = cells.at_vertices(&mesh, &light, false).iter().map(|v| v.x).collect();
    let extrapolated: Vec<f32> = cells.at_vertices(&mesh, &light, true).iter().map(|v| v.x).collect();
    let (corner, edge, inner) = (0, 1, 4);
    assert_eq!(averaged[corner], b1);
    assert_eq!(averaged[edge], (b1 + b2) / 2.0);
    assert_eq!(averaged[inner], (b1 + b2 + b3 + b4) / 4.0);
    assert_eq!(extrapolated[corner], (7.0 * b1 - b2 - b3 - b4) / 4.0);
    assert_eq!(extrapolated[edge], (3.0 * b1 + 3.0 * b2 - b3 - b4) / 4.0);
    assert_eq!(extrapolated[inner], averaged[inner]);
}

#[test]
fn extrapolation_keeps_light_that_is_linear_and_averaging_pulls_the_border_inwards() {
    let n = 6;
    let mesh = grid(n);
    let cells = Cells::new(&mesh);
    let plane = |x: f32, y: f32| 10.0 + 0.5 * x - 0.25 * y;
    let light: Vec<f32> =
        (0..n).flat_map(|j| (0..n).map(move |i| plane(i as f32 + 0.5, j as f32 + 0.5))).collect();
    let light = elements(&light);
    let off = |extrapolate: bool| -> f32 {
        let values = cells.at_vertices(&mesh, &light, extrapolate);
        let parts = values.iter().zip(&mesh.vertices);
        parts.map(|(v, at)| (v.x - plane(at.position.x, at.position.y)).abs()).fold(0.0, f32::max)
    };
    assert!(off(true) < 1e-5, "{}", off(true));
    // Half a cell in both directions, in a corner.
    assert!((off(false) - 0.375).abs() < 1e-5, "{}", off(false));
}

#[test]
fn flat_light_is_that_of_the_cells_and_no_vertex_is_shared() {
    let mesh = grid(3);
    let light = elements(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    assert_eq!(Cells::new(&mesh).flat(&mesh, &light), light);
    let flat = unshared(&mesh);
    flat.validate().expect("a valid mesh");
    assert_eq!(flat.vertices.len(), 3 * mesh.elements.len());
}

#[test]
fn light_is_never_extrapolated_below_zero() {
    let mesh = grid(2);
    let dark = Cells::new(&mesh).at_vertices(&mesh, &elements(&[0.0, 1.0, 1.0, 1.0]), true);
    assert_eq!(dark[0], Rgb::ZERO);
}
