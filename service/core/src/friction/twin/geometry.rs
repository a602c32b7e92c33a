//! Contact between tool and wall as functions of depth, integrated once and then looked up.

use super::config::TwinParams;

/// Spacing of the tables over depth in mm; a tenth of what changes noticeably.
const STEP_MM: f64 = 0.05;

/// Spacing of the integration through the wall in mm.
const SLICE_MM: f64 = 0.1;

/// Contact integrals at one depth. With y the distance below the sheet's upper face and s = z − y the place on
/// the tool, each is an integral over the wall, weighted with the wall's remaining thickness.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Contact {
    /// 2π∫r² where the cone still widens the wall, mm³.
    pub(super) forming_mm3: f64,
    /// 2π∫r² of sliding contact, mm³.
    pub(super) sliding_mm3: f64,
    /// 2π∫r² under the worn area, mm³.
    pub(super) worn_mm3: f64,
    /// Projected area of what carries thrust, mm².
    pub(super) thrust_mm2: f64,
    /// Share of the flash's height that the collar has pressed, 0 to 1.
    pub(super) flash: f64,
}

/// Contact integrals over depth, linearly interpolated.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ContactTable {
    rows: Vec<Contact>,
}

impl ContactTable {
    /// Integrates the contact for every depth at which it can change.
    pub(super) fn new(params: &TwinParams) -> Self {
        let deepest = params.tool.collar_depth_mm() + params.sheet.bushing_length_mm + 1.0;
        let count = index_of(deepest / STEP_MM) + 2;
        #[expect(clippy::cast_precision_loss, reason = "a few thousand rows")]
        let rows = (0..count).map(|row| contact_at(params, row as f64 * STEP_MM)).collect();
        Self { rows }
    }

    /// Contact at a depth; none above the sheet, that of the last row beyond it.
    pub(super) fn at(&self, depth_mm: f64) -> Contact {
        if depth_mm <= 0.0 {
            return Contact::default();
        }
        let place = depth_mm / STEP_MM;
        let index = index_of(place);
        let (Some(a), Some(b)) = (self.rows.get(index), self.rows.get(index + 1)) else {
            return self.rows.last().copied().unwrap_or_default();
        };
        let t = place - place.floor();
        let mix = |a: f64, b: f64| a + t * (b - a);
        Contact {
            forming_mm3: mix(a.forming_mm3, b.forming_mm3),
            sliding_mm3: mix(a.sliding_mm3, b.sliding_mm3),
            worn_mm3: mix(a.worn_mm3, b.worn_mm3),
            thrust_mm2: mix(a.thrust_mm2, b.thrust_mm2),
            flash: mix(a.flash, b.flash),
        }
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a checked depth over a step")]
fn index_of(place: f64) -> usize {
    place.max(0.0) as usize
}

/// A smooth step from 1 to 0 around `middle`.
fn fade(x: f64, middle: f64, width: f64) -> f64 {
    0.5 * (1.0 - ((x - middle) / width).tanh())
}

fn radius(params: &TwinParams, s: f64) -> f64 {
    let tool = &params.tool;
    let (centre, full) = (tool.centre_diameter_mm / 2.0, tool.diameter_mm / 2.0);
    if s <= 0.0 {
        0.0
    } else if s < tool.centre_length_mm {
        centre * s / tool.centre_length_mm
    } else {
        let part = ((s - tool.centre_length_mm) / tool.cone_length_mm).min(1.0);
        centre + part * (full - centre)
    }
}

fn contact_at(params: &TwinParams, depth_mm: f64) -> Contact {
    use std::f64::consts::PI;
    let (tool, sheet, material, wear) = (&params.tool, &params.sheet, &params.material, &params.wear);
    let shoulder = tool.shoulder_depth_mm();
    let full = tool.diameter_mm / 2.0;
    let slope = (full - tool.centre_diameter_mm / 2.0) / tool.cone_length_mm;
    let mut contact = Contact::default();
    let reach = depth_mm.min(sheet.bushing_length_mm);
    let slices = index_of((reach / SLICE_MM).ceil()).max(1);
    #[expect(clippy::cast_precision_loss, reason = "a few hundred slices")]
    let slice = reach / slices as f64;
    for k in 0..slices {
        #[expect(clippy::cast_precision_loss, reason = "a few hundred slices")]
        let y = (k as f64 + 0.5) * slice;
        let s = depth_mm - y;
        let r = radius(params, s);
        let wall = (-(y - sheet.thickness_mm).max(0.0) / sheet.bushing_decay_mm).exp();
        let widening = fade(s, shoulder, tool.shoulder_mm);
        let ring = 2.0 * PI * r * r * wall * slice;
        contact.forming_mm3 += ring * widening;
        contact.sliding_mm3 += ring * (widening + material.cylinder_contact * (1.0 - widening));
        let off = (s - shoulder - wear.offset_mm) / wear.half_length_mm;
        contact.worn_mm3 += ring * (-off * off).exp();
        contact.thrust_mm2 += 2.0 * PI * r * slope * wall * slice * widening;
    }
    // Until the sheet opens, the whole section under the tip has to be pushed aside against closed material.
    let open = sheet.perforation * sheet.thickness_mm;
    let closed = fade(depth_mm, open, sheet.perforation_width * sheet.thickness_mm);
    let tip = radius(params, depth_mm.min(shoulder));
    contact.thrust_mm2 += material.confinement * PI * tip * tip * closed;
    let pressed = depth_mm - (tool.collar_depth_mm() - sheet.flash_height_mm);
    if sheet.flash_height_mm > 0.0 {
        contact.flash = (pressed / sheet.flash_height_mm).clamp(0.0, 1.0);
    }
    contact
}
