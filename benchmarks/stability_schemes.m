% The source's two numerical schemes for the balanced state's Floquet multipliers, written from its description with
% the equations of docs/theory/equations_of_motion.md in the frame that turns with the rotor.
%
%   octave-cli stability_schemes.m POINTS.csv REPEATS
%
% A line of POINTS.csv: M_S, k1, k2, c1, c2, S_A, S_B, J_A, J_B, c3, c4, theta3, theta4, omega (SI, rad).
% Printed, a line each: point, scheme, parts, largest modulus, wall and processor seconds (medians).
1;

function A = matrix_at(t, p)
  ms = p(1); s = p(6:7); j = p(8:9); c = p(10:11); th = p(12:13); w = p(14);
  turn = [cos(w*t), -sin(w*t); sin(w*t), cos(w*t)];
  k = turn' * diag(p(2:3)) * turn;
  d = turn' * diag(p(4:5)) * turn;
  quarter = [0, -1; 1, 0];
  M = zeros(4); C = zeros(4); K = zeros(4);
  M(1:2, 1:2) = ms * eye(2);
  C(1:2, 1:2) = 2 * w * ms * quarter + d;
  K(1:2, 1:2) = k - ms * w^2 * eye(2) + w * d * quarter;
  for i = 1:2
    along = [cos(th(i)); sin(th(i))];
    across = [sin(th(i)); -cos(th(i))];
    M(1:2, 2+i) = -s(i) * across;
    C(1:2, 2+i) = -2 * w * s(i) * along;
    K(1:2, 2+i) = w^2 * s(i) * across;
    M(2+i, 1:2) = -s(i) * across';
    C(2+i, 1:2) = -2 * w * s(i) * across' * quarter;
    K(2+i, 1:2) = w^2 * s(i) * across';
    M(2+i, 2+i) = j(i);
    C(2+i, 2+i) = c(i);
  end
  A = [zeros(4), eye(4); -(M \ K), -(M \ C)];
end

function largest = single_pass(p)
  % all eight columns of the fundamental matrix in one run over a revolution
  options = odeset("RelTol", 1e-8, "AbsTol", 1e-8);
  rate = @(t, y) reshape(matrix_at(t, p) * reshape(y, 8, 8), 64, 1);
  [~, y] = ode45(rate, [0, 2*pi/p(14)], eye(8)(:), options);
  largest = max(abs(eig(reshape(y(end, :), 8, 8))));
end

function largest = piecewise(p, parts)
  % the matrix held constant over each of so many parts of a revolution
  step = 2 * pi / p(14) / parts;
  whole = eye(8);
  for i = 1:parts
    whole = expm(matrix_at((i - 0.5) * step, p) * step) * whole;
  end
  largest = max(abs(eig(whole)));
end

function timed(point, scheme, parts, work, repeats)
  wall = cpu = zeros(1, repeats);
  for i = 1:repeats
    before = cputime(); began = tic();
    largest = work();
    wall(i) = toc(began); cpu(i) = cputime() - before;
  end
  printf("%d,%s,%d,%.17g,%.6g,%.6g\n", point, scheme, parts, largest, median(wall), median(cpu));
  fflush(stdout);
end

arguments = argv();
points = csvread(arguments{1});
repeats = str2double(arguments{2});
piecewise(points(1, :), 2); % loads expm
for point = 1:rows(points)
  p = points(point, :);
  timed(point - 1, "single pass", 0, @() single_pass(p), repeats);
  for parts = [100, 400]
    timed(point - 1, "piecewise", parts, @() piecewise(p, parts), repeats);
  end
end
