function run = read_imuarray(file)
%READ_IMUARRAY  Read a log of imuarray: all sensors, in counts and in SI units.
%   run = read_imuarray('run.h5') reads the log itself (MATLAB R2016b or later);
%   run = read_imuarray('run.mat') reads `imuarray export run.h5 -o run.mat` (GNU Octave too).
%
%   run.epoch is the date and time (UTC) of time 0; run.NAME has, for each sensor,
%     time_s    n-by-1  seconds since the epoch
%     counts    n-by-3  raw counts along the sensor's own axes
%     values    n-by-3  m/s2, rad/s or T along the axes of the box, by the data sheet's sensitivity
%     status    n-by-1  flags: 1 stale, 2 overrun, 4 saturated, 8 readings lost just before
%
%   Example:  run = read_imuarray('tumble.h5');  plot(run.Gyro1.time_s, run.Gyro1.values)
  if endsWith_(file, '.mat')
    run = read_mat(file);
  else
    run = read_log(file);
  end
end

function run = read_log(file)
  run.epoch = h5readatt(file, '/', 'epoch');
  groups = h5info(file, '/sensors').Groups;
  for k = 1:numel(groups)
    path = groups(k).Name;
    parts = strsplit(path, '/');
    columns = {groups(k).Datasets.Name};
    sensor.time_s = double(h5read(file, [path '/time'])) / 1e9;
    sensor.counts = double(h5read(file, [path '/counts'])).';  % HDF5 counts dimensions the other way round
    sensor.status = [];
    if any(strcmp(columns, 'status'))
      sensor.status = h5read(file, [path '/status']);
    end
    sensor.values = [];
    unit = si_per_unit(h5readatt(file, path, 'unit'));
    sensitivity = h5readatt(file, path, 'sensitivity');
    if unit > 0 && sensitivity > 0
      orientation = h5readatt(file, path, 'orientation').';  % box = orientation * sensor
      sensor.values = sensor.counts * (unit / sensitivity) * orientation.';
    end
    run.(parts{end}) = sensor;
  end
end

function run = read_mat(file)
  saved = load(file);
  run.epoch = saved.imuarray.epoch;
  names = saved.imuarray.variables;
  for k = 1:numel(names)
    table = saved.(names{k});
    if ~isfield(table, 'counts')
      continue
    end
    about = jsondecode(table.about_json);
    sensor.time_s = table.time_s;
    sensor.counts = double(table.counts);
    sensor.status = table.status;
    sensor.values = [];
    if isfield(about, 'si_per_count')
      sensor.values = sensor.counts * about.si_per_count * reshape(about.orientation, 3, 3).';
    end
    run.(names{k}) = sensor;
  end
end

function factor = si_per_unit(unit)
  switch char(unit)
    case 'g',     factor = 9.80665;
    case 'dps',   factor = pi / 180;
    case 'gauss', factor = 1e-4;
    otherwise,    factor = 0;
  end
end

function yes = endsWith_(text, suffix)
  yes = numel(text) >= numel(suffix) && strcmpi(text(end - numel(suffix) + 1:end), suffix);
end
