"""Metadata of a session: what the operator of an instrument knows about it."""

from __future__ import annotations

from gonio.instrument import Instrument
from gonio.metadata import (
    SCHEMA,
    Camera,
    Channel,
    Geometry,
    LampRecord,
    LensCalibration,
    Limits,
    Metadata,
    Plan,
)


def metadata(
    instrument: Instrument, plan: Plan, sample: str, fingerprint: str, rig: str | None = None
) -> Metadata:
    """Metadata of a session on a virtual instrument: its data sheets, without its random errors.

    Parameters
    ----------
    instrument : Instrument
    plan : Plan
    sample : str
        Name of the sample.
    fingerprint : str
        Hash of all inputs of the session.
    rig : str, optional
        Identity of the rig.
    """
    return Metadata(
        schema=SCHEMA,
        instrument=instrument.name,
        sample=sample,
        geometry=_geometry(instrument),
        lens=_lens(instrument),
        camera=_camera(instrument),
        standard=instrument.standard.certificate(),
        lamp=_lamp(instrument, plan),
        limits=_limits(instrument),
        plan=plan,
        rig=rig,
        fingerprint=fingerprint,
    )


def channels(instrument: Instrument) -> tuple[Channel, ...]:
    """The channels of a session: names and wavelengths of the filters."""
    return tuple(Channel(name=f.name, wavelength_nm=f.wavelength_nm) for f in instrument.channels)


def irradiance_uncertainty(instrument: Instrument, plan: Plan) -> float | None:
    """Relative uncertainty of the irradiance at an incidence without standard; None if not needed.

    The cosine is known. The transmittance of the dome varies with the point where the beam enters:
    at both incidences in reflection, only at that of the standard in transmission.
    """
    if plan.standard_theta_i_deg is None:
        return None
    n_crossings = 1 if plan.mode == "transmission" else 2
    return float(instrument.dome.transmittance_variation * n_crossings**0.5)


def _geometry(instrument: Instrument) -> Geometry:
    lens, dome = instrument.lens, instrument.dome
    alignment_known = lens.alignment_known
    return Geometry(
        shape=dome.shape,
        R=dome.R,
        D=dome.D,
        usable_theta_r_deg=instrument.usable_theta_r_deg,
        pupil_mm=lens.pupil_offset_mm if alignment_known else (0.0, 0.0, 0.0),
        pupil_walk_mm=lens.pupil_walk_mm if alignment_known else 0.0,
        camera_azimuth_deg=lens.azimuth_deg if alignment_known else 0.0,
    )


def _lens(instrument: Instrument) -> LensCalibration:
    lens, sensor = instrument.lens, instrument.sensor
    moved = lens.alignment_known and any(sensor.centre_offset_px)
    return LensCalibration(
        projection=lens.projection,
        focal_length_mm=lens.focal_length_mm,
        k=lens.k,
        field_deg=lens.field_deg,
        centre_px=sensor.centre_px() if moved else None,
    )


def _camera(instrument: Instrument) -> Camera:
    sensor = instrument.sensor
    u_nonlinearity = sensor.u_nonlinearity_per_decade
    if u_nonlinearity is None and not sensor.nonlinearity_per_decade:
        u_nonlinearity = 0.0  # the operator of a linear camera measured that it is linear
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
        u_nonlinearity_per_decade=u_nonlinearity,
    )


def _lamp(instrument: Instrument, plan: Plan) -> LampRecord:
    """The operator measures the change of the output between images of the same incidence."""
    lamp = instrument.lamp
    wandered = lamp.slow_drift * len(plan.theta_i_deg) ** 0.5
    return LampRecord(
        half_angle_deg=lamp.half_angle_deg,
        u_half_angle_deg=lamp.half_angle_uncertainty * lamp.half_angle_deg,
        drift=float((lamp.drift**2 + wandered**2) ** 0.5) if wandered else lamp.drift,
    )


def _limits(instrument: Instrument) -> Limits:
    share = instrument.surroundings.multibounce_uncertainty
    return Limits(
        slope_error_deg=instrument.dome.slope_error_deg,
        rim_slope_error_deg=instrument.dome.rim_slope_error_deg,
        slope_correlation_deg=instrument.dome.slope_correlation_deg,
        multibounce=instrument.surroundings.multibounce,
        u_multibounce=None if share is None else share * instrument.surroundings.multibounce,
        transmittance=instrument.dome.transmittance,
        ambient=instrument.surroundings.ambient_reflected,
        u_azimuth_deg=instrument.holder.u_azimuth_deg,
    )
