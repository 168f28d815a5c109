//! Work over time: opening, requesting pictures, training, saving. Every file adds its part to
//! [`Shared`](crate::viewer::shared::Shared).

mod asking;
mod exporting;
mod marking;
mod notes;
mod opening;
mod pointing;
mod saving;
mod training;
