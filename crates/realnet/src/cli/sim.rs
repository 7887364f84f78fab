//! `realnet sim`: its results as JSON, as tables, as pages and as videos.
#![allow(dead_code, reason = "the command is wired when the closed loop stands")]

mod json;
mod report;
mod table;
