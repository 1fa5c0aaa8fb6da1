"""What the operator of an instrument knows of it, and so what a session's metadata may say."""

from __future__ import annotations

from gonio.instrument import Instrument
from gonio.metadata import (
    SCHEMA,
    Camera,
    Certificate,
    Channel,
    Geometry,
    LampRecord,
    LensCalibration,
    Limits,
    Metadata,
    Plan,
)


def metadata(rig: Instrument, plan: Plan, sample: str, fingerprint: str) -> Metadata:
    """Metadata of a session on a virtual instrument: its data sheets, not its chance.

    Parameters
    ----------
    rig : Instrument
    plan : Plan
    sample : str
        Name of the sample.
    fingerprint : str
        Hash of what makes the session.
    """
    return Metadata(
        schema=SCHEMA,
        instrument=rig.name,
        sample=sample,
        geometry=_geometry(rig),
        lens=_lens(rig),
        camera=_camera(rig),
        standard=_certificate(rig),
        lamp=_lamp(rig, plan),
        limits=_limits(rig),
        plan=plan,
        fingerprint=fingerprint,
    )


def channels(rig: Instrument) -> tuple[Channel, ...]:
    """The channels of a session: names and wavelengths of the filters."""
    return tuple(Channel(name=f.name, wavelength_nm=f.wavelength_nm) for f in rig.channels)


def irradiance_uncertainty(rig: Instrument, plan: Plan) -> float | None:
    """What the irradiance at another incidence than the standard's is known to; None if alike.

    The cosine is known; the dome's transmittance where the beam enters varies, at both places in
    reflection and at the standard's alone in transmission.
    """
    if plan.standard_theta_i_deg is None:
        return None
    places = 1 if plan.mode == "transmission" else 2
    return float(rig.dome.transmittance_variation * places**0.5)


def _geometry(rig: Instrument) -> Geometry:
    lens, dome = rig.lens, rig.dome
    known = lens.alignment_known
    return Geometry(
        shape=dome.shape,
        R=dome.R,
        D=dome.D,
        usable_theta_r_deg=rig.usable_theta_r_deg,
        pupil_mm=lens.pupil_offset_mm if known else (0.0, 0.0, 0.0),
        pupil_walk_mm=lens.pupil_walk_mm if known else 0.0,
        camera_azimuth_deg=lens.azimuth_deg if known else 0.0,
    )


def _lens(rig: Instrument) -> LensCalibration:
    lens, sensor = rig.lens, rig.sensor
    moved = lens.alignment_known and any(sensor.centre_offset_px)
    return LensCalibration(
        projection=lens.projection,
        focal_length_mm=lens.focal_length_mm,
        k=lens.k,
        field_deg=lens.field_deg,
        centre_px=sensor.centre_px() if moved else None,
    )


def _camera(rig: Instrument) -> Camera:
    sensor = rig.sensor
    rows, columns = sensor.shape
    pitch_x, pitch_y = (p * 1e-3 * sensor.binning for p in sensor.pitch_um)
    return Camera(
        rows=rows,
        columns=columns,
        pitch_mm=(pitch_x, pitch_y),
        gain_dn_per_e=sensor.binned_gain_dn_per_e,
        black_dn=sensor.binned_black_dn,
        saturation_dn=sensor.saturation_dn,
        full_well_e=sensor.binned_full_well_e,
        noise_dn=sensor.binned_noise_dn,
        dark_e_per_s=sensor.dark_e_per_s * sensor.n_summed,
        gamma=sensor.gamma,
    )


def _certificate(rig: Instrument) -> Certificate:
    standard = rig.standard
    return Certificate(
        reflectance=standard.reflectance,
        uncertainty=standard.uncertainty,
        rolloff=standard.rolloff if standard.rolloff_certified else 0.0,
        rolloff_uncertainty=standard.rolloff_uncertainty,
    )


def _lamp(rig: Instrument, plan: Plan) -> LampRecord:
    """The operator sees by how much the output changes until the same incidence comes again."""
    lamp = rig.lamp
    wandered = lamp.slow_drift * len(plan.theta_i_deg) ** 0.5
    return LampRecord(
        half_angle_deg=lamp.half_angle_deg,
        drift=float((lamp.drift**2 + wandered**2) ** 0.5) if wandered else lamp.drift,
    )


def _limits(rig: Instrument) -> Limits:
    share = rig.surroundings.multibounce_uncertainty
    return Limits(
        slope_error_deg=rig.dome.slope_error_deg,
        rim_slope_error_deg=rig.dome.rim_slope_error_deg,
        slope_correlation_deg=rig.dome.slope_correlation_deg,
        multibounce=rig.surroundings.multibounce,
        u_multibounce=None if share is None else share * rig.surroundings.multibounce,
        transmittance=rig.dome.transmittance,
        ambient=rig.surroundings.ambient_reflected,
        u_azimuth_deg=rig.holder.u_azimuth_deg,
    )
